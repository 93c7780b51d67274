# SPDX-License-Identifier: GPL-2.0-or-later
"""Two runs, one verdict: whether they can be compared, then what got worse, better, or is another. docs/compare.md."""

from __future__ import annotations

import glob
import html
import json
import math
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from tqdm import tqdm

from . import pages
from .errors import SetupError, count_of
from .flight import Flight, read_flight
from .follow import SHAPES, Following
from .intervals import BLOCK, Change, change, more_often, shift
from .load import Load, load_bins, terms
from .scratch import scratch
from .series import APART, DEGREES, Array, Samples, joined, samples
from .sources import controllers, source_name
from .tshark import Tshark

Record = dict[str, Any]
LEAST_SECONDS, LEAST_COMMON = 20.0, 0.3  # of a run; share of its samples at loads of both
CHANCE, CHANCE_OF_EVENTS = 0.02, 0.04  # that one of all comparisons is called worse by chance
# The least change that counts: relative where it is a multiple, else in the unit.
LEAST = {"A": 0.015, "°C": 1.5, "%": 2.0, "jitter": 0.3, "rate": 0.02, "lag": 20.0}
LEAST_OF_ALL = 0.02  # of a multiple that all controllers have: it may be the wind
MANY = 3  # flights of each side, over which wind and weather are even
ALIKE = "it may be the weather: three flights of each side would tell"
LAGS = np.arange(-0.2, 1.2, 0.01)
# Events that are no fault of a controller's, or have a comparison of their own.
OTHER_EVENTS = ("fault", "unknown", "absent", "clock", "unfinished", "shared")
LOSSES = ("incomplete", "crc", "missing", "skipped", "dropped", "stale")
ORDER = {"worse": 0, "changed": 1, "better": 2}


@dataclass
class Run:
    """One side: its flights, their messages by (controller, message), and what tshark says of them."""

    name: str
    flights: list[Flight] = field(default_factory=list)
    samples: dict[tuple[str, str], Samples] = field(default_factory=dict)
    events: list[Record] = field(default_factory=list)
    sizes: dict[tuple[str, str], set[int]] = field(default_factory=lambda: defaultdict(set))
    verdicts: list[Record] = field(default_factory=list)

    def seconds(self) -> float:
        """Return how long the flights are, without the time between them."""
        longest: dict[float, float] = defaultdict(float)
        for one in self.samples.values():
            for number in np.unique(one.times // APART):
                longest[number] = max(longest[number], float(np.ptp(one.times[one.times // APART == number])))
        return sum(longest.values())

    def where(self, one: Samples, at: int) -> Record:
        """Return file, frame and time of a sample."""
        flight = self.flights[int(one.times[at] // APART)]
        return {"file": flight.name, "frame": int(one.frames[at]), "time": round(float(one.times[at] % APART), 3)}


@dataclass
class Pair:
    """A message of a controller in both runs. times, is_after: (n), of all samples of BEFORE, then of AFTER."""

    runs: tuple[Run, Run]
    sides: tuple[Samples, Samples]
    loads: tuple[Load, Load] | None = None

    def __post_init__(self) -> None:
        """Put the times of both behind each other."""
        self.times = np.concatenate([one.times for one in self.sides])
        self.is_after = np.repeat([False, True], [len(one.times) for one in self.sides])

    def column(self, name: str) -> Array:
        """Return the values of both, (n)."""
        return np.concatenate([one.columns[name] for one in self.sides])

    def change(self, values: Array, good: Array, load: Array | None = None) -> Change | None:
        """Return how much higher the good values are AFTER."""
        load = None if load is None else load[good]
        return change(self.times[good], values[good], self.is_after[good], load)

    def begins(self) -> tuple[Record, Record]:
        """Return the first sample of each run."""
        return self.runs[0].where(self.sides[0], 0), self.runs[1].where(self.sides[1], 0)

    def typical(self, good: Array, values: Array) -> tuple[Record, Record]:
        """Return where each run has the good value that is nearest to its own median."""
        places = []
        for side, (run, own) in enumerate(zip(self.runs, self.sides, strict=True)):
            part = values[self.is_after == bool(side)]
            at = np.flatnonzero(good[self.is_after == bool(side)])
            nearest = at[np.argmin(np.abs(part[at] - np.median(part[at])))]
            places.append(run.where(own, int(nearest)))
        return places[0], places[1]


@dataclass
class Finding:
    """What differs. kind: "worse", "better", "changed"; numbers: values of both runs in unit, their change, and its
    95 % interval; weight: how many times the least change that counts; at: where it shows, of both runs."""

    kind: str
    controller: str
    measure: str
    text: str
    unit: str = ""
    numbers: Sequence[float | None] = (None,) * 5
    weight: float = 1.0
    at: tuple[Record, Record] = ({}, {})

    def record(self) -> Record:
        """Return a JSON line."""
        known = {name: value for name, value in vars(self).items() if name not in ("at", "weight", "numbers")}
        known |= zip(("before", "after", "change", "low", "high"), self.numbers, strict=True)
        for side, at in zip(("before", "after"), self.at, strict=True):
            known |= {f"{side}_{name}": at.get(name) for name in ("file", "frame", "time")}
        return known

    def sentence(self) -> str:
        """Return it for people."""
        both = zip(("before", "after"), self.at, strict=True)
        where = ", ".join(f"{side} frame {at['frame']} at {at['time']:.3f} s" for side, at in both if at)
        return f"{self.kind}: {self.controller}: {self.text}{f' ({where})' if where else ''}"


@dataclass
class Comparison:
    """reason: why the runs cannot be compared, empty where they can; notes: what to know of the answer."""

    runs: tuple[Run, Run]
    pairs: list[Pair] = field(default_factory=list)
    reason: str = ""
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    compared: list[tuple[str, str]] = field(default_factory=list)

    @property
    def code(self) -> int:
        """20 if something got worse, 21 if that could not be judged, 0 otherwise."""
        if any(finding.kind == "worse" for finding in self.findings):
            return 20
        return 21 if self.reason or any(flight.left_out for run in self.runs for flight in run.flights) else 0


def captures_of(given: str) -> list[Path]:
    """Return the captures that one side of the command means: a file, a folder, or a pattern. Raises SetupError."""
    path = Path(given)
    names = sorted(map(str, path.iterdir())) if path.is_dir() else sorted(glob.glob(given, recursive=True)) or [given]
    found = [Path(os.path.abspath(name)) for name in names if not Path(name).is_dir()]
    if not found:
        raise SetupError(f"no capture in {given}: name a capture, a folder of them, or a pattern in quotes")
    return found


def compare(before: Sequence[Path], after: Sequence[Path], tshark: Tshark, rules: Path | None = None) -> Comparison:
    """Return what differs between two runs, each of one or several captures. Raises YappError."""
    found = Comparison((_read("BEFORE", before, tshark, rules), _read("AFTER", after, tshark, rules)))
    for run in found.runs:
        said = dict.fromkeys(text for flight in run.flights for text in flight.left_out)
        found.notes += [f"{run.name}: {text}" for text in said]
    found.reason = _reason(found)
    if not found.reason:
        found.findings = [*_values(found), *_events(found), *_interface(found), *_rules(found)]
        found.findings.sort(key=lambda one: (ORDER[one.kind], -one.weight))
    return found


def _read(name: str, captures: Sequence[Path], tshark: Tshark, rules: Path | None) -> Run:
    found, run = [], Run(name)
    for number, capture in enumerate(tqdm(captures, desc=name, unit="flight", disable=None, leave=False)):
        flight = read_flight(capture, tshark, has_begin=True)
        own = samples(flight, number, flight.start())
        run.flights.append(flight)
        found.append(own)
        keys = {ids: key for key, one in own.items() for ids in one.ids}
        events = flight.events.append_column("at", flight.events["time"].cast("int64")).drop_columns("time").to_pylist()
        for event, who in zip(events, controllers(events), strict=True):
            at = 0.0 if event["at"] is None else (event["at"] - flight.start()) / 1e9
            known = keys.get((event["bus"], event["id"]))
            event |= {"at": {"file": flight.name, "frame": event["frame"], "time": round(at, 3)}}
            event["who"] = known[0] if known else who if isinstance(who, str) else source_name(event)
        run.events += events
        for bus, ident, size in tshark.packets(capture, ("yapp.bus", "yapp.id", "yapp.size")):
            if key := keys.get((bus or None, int(ident, 0))):
                run.sizes[key].add(int(size))
        if rules:
            with scratch() as folder:
                (folder / "rules").write_text(rules.read_text(encoding="utf-8"), encoding="utf-8")
                run.verdicts += tshark.ask(capture, str(folder), ["check,rules=rules,json"])[0]
    run.samples = joined(found)
    return run


def _reason(found: Comparison) -> str:
    """Return why the runs cannot be compared; empty where they can, with their pairs, and what they have in common."""
    before, after = found.runs
    for run in found.runs:
        if run.seconds() < LEAST_SECONDS:
            return f"{run.name} lasts {run.seconds():.3g} s; {LEAST_SECONDS:g} s are needed"
    only = [
        f"{who} ({one.samples[who, message].title}) is in {one.name} only"
        for one, other in ((before, after), (after, before))
        for who, message in one.samples
        if (who, message) not in other.samples
    ]
    if only:
        return f"the controllers differ: {'; '.join(only[:4])}; name them alike with -o yapp.sources"
    found.pairs = [Pair(found.runs, (one, after.samples[key])) for key, one in before.samples.items()]
    loads = {pair.sides[0].controller: _loads(pair) for pair in found.pairs if pair.sides[0].speed()}
    shares: list[list[float]] = [[], []]
    for pair in found.pairs:
        pair.loads = loads.get(pair.sides[0].controller)
        if pair.loads and pair.sides[0].speed():
            common, moving = terms(*pair.loads, False)[1], bins_of_both(pair.loads) >= 0
            for side, own in enumerate(shares):
                use = pair.is_after == bool(side)
                own.append(float(common[use].sum() / max(moving[use].sum(), 1)))
    if shares[0]:
        low, high = (float(np.median(own)) for own in shares)
        both = f"{low:.0%} of BEFORE and {high:.0%} of AFTER are at a speed and voltage that both have"
        if min(low, high) < LEAST_COMMON:
            return f"too few loads in common: {both}; fly the same manoeuvres"
        found.notes.append(both)
    return ""


def _loads(pair: Pair) -> tuple[Load, Load] | None:
    one, other = (Load.of(side) for side in pair.sides)
    return None if one is None or other is None else (one, other)


def bins_of_both(loads: tuple[Load, Load]) -> Array:
    """Return the bins of the samples of both runs, one behind the other."""
    speed, volts = (np.concatenate([getattr(load, name) for load in loads]) for name in ("speed", "volts"))
    return load_bins(speed, volts)


@dataclass
class _Measured:
    """A value of a controller in both runs. least: a key of LEAST; base: the value BEFORE, in the unit;
    worse: the sign of a change that is worse; beside: the change beyond what two or more others have."""

    controller: str
    title: str
    unit: str
    least: str
    is_multiple: bool
    change: Change
    base: float
    at: tuple[Record, Record]
    worse: int = 1
    beside: Change | None = None


def _values(found: Comparison) -> Iterator[Finding]:
    """Compare values at equal load, intervals between messages, and how a command is followed."""
    measured: list[_Measured] = []
    for pair in found.pairs:
        for name in pair.sides[0].names("value", "A", "%", *DEGREES):
            measured += _value(pair, name)
        measured += _intervals(pair)
        measured += _lag(pair)
    found.compared += [(one.controller, one.title) for one in measured]
    yield from _judged(measured, min(len(run.flights) for run in found.runs) >= MANY)


def _value(pair: Pair, name: str) -> Iterator[_Measured]:
    """Compare a value at equal load. Speed is the load itself; power follows from current."""
    one = pair.sides[0]
    unit, title = one.unit_of(name), one.title_of(name)
    is_load = name in (one.speed() or ()) or name.endswith(("_commanded", "_error"))
    if is_load or not one.names("clock") or name not in pair.sides[1].columns:
        return
    values = pair.column(name)
    load, common = None, np.ones(len(values), bool)
    if pair.loads:
        at = [load.at(side.times) for load, side in zip(pair.loads, pair.sides, strict=True)]
        load, common = terms(at[0], at[1], unit in DEGREES)
    good = common & np.isfinite(values)
    shown, is_multiple = values, unit == "A"
    if is_multiple:
        if not good.any() or (values[good] > 0).mean() <= 0.98:
            return  # a current of both signs has no multiple
        good &= values > 0.1 * np.nanmedian(values[good])
        shown = np.log(np.where(good, values, 1.0))
    result = pair.change(shown, good, load)
    if result is None:
        return
    beside, usual = None, [_usual(pair, side, name, is_multiple) for side in (0, 1)]
    if unit != "%" and len(usual[0]) and len(usual[1]):
        beside = pair.change(shown - np.concatenate(usual), good, load)
    base, least = float(values[good & ~pair.is_after].mean()), "°C" if unit in DEGREES else unit
    at_both = pair.typical(good, values)
    yield _Measured(one.controller, title, unit, least, is_multiple, result, base, at_both, beside=beside)


def _usual(pair: Pair, side: int, name: str, is_multiple: bool) -> Array:
    """Return how far the others are from their levels BEFORE, their median, at the times of one controller.

    Empty where there are fewer than two others. Wind and weather are the same for all: what one has beyond the others
    shows sooner. Each has its own level, as the median of levels would jump where two swap places.
    """
    lines, own = [], pair.sides[side]
    for (who, message), one in pair.runs[side].samples.items():
        if message == own.message and who != own.controller and name in one.columns:
            good = np.isfinite(one.columns[name])
            level = float(np.nanmedian(pair.runs[0].samples[who, message].columns[name]))
            if good.sum() > 50 and (level > 0 or not is_multiple):
                values = np.interp(own.times, one.times[good], one.columns[name][good])
                lines.append(np.log(np.maximum(values, 1e-9) / level) if is_multiple else values - level)
    return np.asarray(np.median(lines, axis=0)) if len(lines) > 1 else np.zeros(0)


def _intervals(pair: Pair) -> Iterator[_Measured]:
    """Compare the period, and how much single intervals differ from it; silences and losses are events."""
    who, title = pair.sides[0].controller, pair.sides[0].title
    if min(len(one.times) for one in pair.sides) < 50:
        return
    gaps = np.concatenate([one.gaps() for one in pair.sides])
    periods = [float(np.nanmedian(gaps[pair.is_after == side])) for side in (False, True)]
    period = np.where(pair.is_after, periods[1], periods[0])
    good = np.isfinite(gaps) & (gaps < 1.7 * period)
    at = pair.typical(good, gaps)
    rate = pair.change(-np.log(np.maximum(gaps, 1e-6)), good)
    if rate:
        yield _Measured(who, f"rate of {title}", "Hz", "rate", True, rate, 1 / periods[0], at, worse=-1)
    keys, block = np.unique(np.floor(pair.times / BLOCK) * 2 + pair.is_after, return_inverse=True)
    count = np.bincount(block, good)
    spread = np.bincount(block, np.where(good, np.abs(gaps - period), 0.0)) / np.maximum(count, 1)
    known = (count > 0.5 * BLOCK / max(periods)) & (spread > 1e-6)
    is_after, logs = keys[known] % 2 > 0, np.log(spread[known])
    if jitter := change(keys[known] // 2 * BLOCK, logs, is_after):
        base = float(np.exp(logs[~is_after].mean())) * 1e3
        yield _Measured(who, f"jitter of {title}", "ms", "jitter", True, jitter, base, at)


def _lag(pair: Pair) -> Iterator[_Measured]:
    """Compare how long after its command a value follows, with one shape of the response for both runs."""
    one, speed = pair.sides[0], pair.sides[0].speed()
    if speed is None or speed[0] not in pair.sides[1].columns:
        return
    both = [Following.of(run.samples, side) for run, side in zip(pair.runs, pair.sides, strict=True)]
    runs = [run for run in both if run]
    if len(runs) < 2:
        return
    sums = [sum(run.least(shape, LAGS[::5]) for run in runs) for shape in range(len(SHAPES))]
    shape = int(np.argmin(sums))
    results = [found for run in runs if (found := shift(run.times, partial(run.squares, shape), LAGS))]
    if len(results) < 2:
        return
    (before, first, count), (after, second, many) = results
    result = Change((after - before) * 1e3, math.hypot(first, second) * 1e3, 2 * min(count, many) - 2)
    title = f"response of {one.title_of(speed[0])} to its command"
    yield _Measured(
        one.controller, title, "ms", "lag", False, result, (before + SHAPES[shape]) * 1e3, pair.begins()
    )  # fmt: skip


def _judged(measured: list[_Measured], is_many: bool) -> Iterator[Finding]:
    """Say which changes lie beyond their interval: that of all comparisons together, and the least that counts.

    What all controllers have in common is one finding. It may be wind and weather: only of many flights it is worse.
    """
    chance = CHANCE / max(1, len(measured))
    groups: dict[tuple[str, str], list[_Measured]] = defaultdict(list)
    for one in measured:
        groups[one.title, one.least].append(one)
    # A constant knows no weather.
    warm = [
        group for (_, least), group in groups.items() if least == "°C" and any(one.change.error > 0.02 for one in group)
    ]
    shifts = [float(np.median([one.change.value for one in group])) for group in warm]
    # By how much it was warmer: what all temperatures that move have in common, the least of them.
    weather = min(shifts, key=abs) if len(shifts) > 1 else 0.0
    for (_, least), group in groups.items():
        values = np.array([one.change.value for one in group])
        cause = weather if any(group is one for one in warm) else 0.0
        has_peers = all(one.beside for one in group)
        if has_peers:
            middle = float(np.median(values))
            error = 1.25 * float(np.median([one.change.error for one in group])) / math.sqrt(len(group))
            whole = Change(middle - cause, error, min(one.change.freedom for one in group))
            typical = group[int(np.argmin(np.abs(values - middle)))]
            bound = LEAST_OF_ALL if typical.is_multiple else LEAST[least]
            for finding in _finding(typical, whole, chance, bound, f"all {len(group)} controllers"):
                if not is_many:
                    finding.kind, finding.text = "changed", f"{finding.text}; {ALIKE}"
                yield finding
        for one in group:
            bound = LEAST_OF_ALL if least == "A" and not has_peers else LEAST[least]
            yield from _finding(one, one.beside or one.change.less(cause), chance, bound, one.controller)


def _finding(one: _Measured, change: Change, chance: float, bound: float, who: str) -> Iterator[Finding]:
    sure_low, sure_high = change.within(chance)
    if not (sure_low > 0 or sure_high < 0) or abs(change.value) < bound:
        return
    kind = "worse" if change.value * one.worse > 0 else "better"
    ends = (change.value, *change.within())
    if one.is_multiple:
        numbers = [math.expm1(end) for end in ends]
        now = one.base * (1 + numbers[0])
        if -0.33 < numbers[0] < 0.5:
            percents = [number * 100 for number in numbers]
            text = f"{percents[0]:+.3g} % ({percents[1]:+.2g} to {percents[2]:+.2g} %)"
        else:
            text = f"{numbers[0] + 1:.3g} times ({numbers[1] + 1:.3g} to {numbers[2] + 1:.3g})"
    else:
        numbers, unit = list(ends), "points" if one.unit == "%" else one.unit
        now = one.base + numbers[0]
        text = f"{numbers[0]:+.3g} {unit} ({numbers[1]:+.3g} to {numbers[2]:+.3g})"
    load = " at equal load" if one.least in ("A", "°C", "%") else ""
    others = " beyond the others" if change is one.beside else ""
    text = f"{one.title} {text}, {one.base:.4g} -> {now:.4g} {one.unit}{load}{others}"
    weight = abs(change.value) / bound
    yield Finding(kind, who, one.title, text, one.unit, (one.base, now, *numbers), weight, one.at)


def _events(found: Comparison) -> Iterator[Finding]:
    """Compare how often faults, reboots, losses and the like came: new, gone, more often, less often."""
    seconds = found.runs[0].seconds(), found.runs[1].seconds()
    share = seconds[1] / sum(seconds)
    counts: dict[tuple[str, str], tuple[list[Record], list[Record]]] = defaultdict(lambda: ([], []))
    for side, run in enumerate(found.runs):
        for event in run.events:
            is_raised = event["kind"] == "fault" and event["event"] == "raised"
            if is_raised or event["kind"] not in OTHER_EVENTS:
                counts[event["who"], str(event["flag"] or event["kind"])][side].append(event)
    faulty = {who for (who, what), sides in counts.items() if what != "faulted" and (sides[0] + sides[1])[0]["flag"]}
    for who in faulty:  # a state beside the flags
        counts.pop((who, "faulted"), None)
    found.compared += list(counts)
    chance = CHANCE_OF_EVENTS / max(1, len(counts))
    for (who, what), sides in counts.items():
        few, many = (sum(int(event["count"] or 1) for event in side) for side in sides)
        clumps = _clumps(sides, seconds)
        is_more = more_often(few, many, share, clumps) < chance
        is_less = more_often(many, few, 1 - share, clumps) < chance
        kind = "worse" if is_more else "better" if is_less else "changed"
        if kind == "changed" and (few or what in LOSSES):
            continue
        hours = [number / length * 3600 for number, length in zip((few, many), seconds, strict=True)]
        word = "new" if not few else "gone" if not many else "more often" if many > few else "less often"
        doubt = "; too few to tell" if kind == "changed" else ""
        text = f"{what} {word}: {few} -> {many} times, {hours[0]:.3g} -> {hours[1]:.3g} an hour{doubt}"
        weight = many / max(few, 1) + 1 if is_more else 0.5
        at = [next((event["at"] for event in side if event["frame"]), Record()) for side in sides]
        numbers = (*hours, hours[1] - hours[0], None, None)
        yield Finding(kind, who, what, text, "an hour", numbers, weight, (at[0], at[1]))


def _clumps(sides: tuple[list[Record], list[Record]], seconds: tuple[float, float]) -> float:
    """Return the variance of blocks' counts over their mean, 1 where chance explains it: losses come in bursts."""
    largest = 1.0
    for side, length in zip(sides, seconds, strict=True):
        blocks = max(int(length / 10), 2)
        counts = np.zeros(blocks)
        for event in side:
            counts[min(int(event["at"]["time"] / 10), blocks - 1)] += int(event["count"] or 1)
        if counts.sum() > 3:
            spread = float(counts.var(ddof=1) / counts.mean())
            largest = max(largest, spread if spread > 1 + 3 * math.sqrt(2 / (blocks - 1)) else 1.0)
    return largest


def _interface(found: Comparison) -> Iterator[Finding]:
    """Compare IDs, sizes and the meanings of enums. A message that grew takes more of the bus."""
    for pair in found.pairs:
        one, other = pair.sides
        who, at = one.controller, pair.begins()
        if one.ids != other.ids:
            ids = [
                ", ".join(f"{bus or ''} 0x{ident:03x}".strip() for bus, ident in sorted(own.ids, key=str))
                for own in pair.sides
            ]
            yield Finding("changed", who, f"ID of {one.title}", f"ID of {one.title} {ids[0]} -> {ids[1]}", at=at)
        sizes = [sorted(run.sizes[who, one.message]) for run in pair.runs]
        if sizes[0] != sizes[1] and all(sizes):
            texts = [" and ".join(map(str, own)) for own in sizes]
            grown = max(sizes[1]) - max(sizes[0])
            text = f"size of {one.title} {texts[0]} -> {texts[1]} bytes ({grown:+d})"
            kind, numbers = "worse" if grown > 0 else "changed", (max(sizes[0]), max(sizes[1]), grown, grown, grown)
            yield Finding(kind, who, f"size of {one.title}", text, "bytes", numbers, 3.0, at)
        for name in one.names("enum"):
            title = one.title_of(name)
            was, now = (own.texts.get(name, set()) for own in pair.sides)
            news = [f"{text} is new" for text in sorted(now - was)] + [f"{text} is gone" for text in sorted(was - now)]
            if news:
                yield Finding("changed", who, title, f"{title}: {', '.join(news)}", at=at)


def _rules(found: Comparison) -> Iterator[Finding]:
    """Compare the verdicts on the rules of a file."""
    sides: list[dict[tuple[str, str], Record]] = [{}, {}]
    for side, run in zip(sides, found.runs, strict=True):
        for row in run.verdicts:
            key = row["rule"], row["source"] or ""
            if key not in side or side[key]["ok"] is True:  # of several captures the worst
                side[key] = row
    words = {True: "held", False: "did not hold", None: "could not be judged"}
    for key, row in sides[1].items():
        was = sides[0].get(key, {"ok": None})["ok"]
        if was != row["ok"]:
            kind = "worse" if row["ok"] is False else "better" if was is False and row["ok"] else "changed"
            seen = f" (seen {row['seen']}, limit {row['limit']})" if row.get("seen") is not None else ""
            frame = f", frame {row['frame']}" if row.get("frame") else ""
            text = f"rule {key[0]} {words[was]}, now {words[row['ok']]}{seen}{frame}"
            yield Finding(kind, key[1] or "all", key[0], text, weight=10.0)


def lines(found: Comparison) -> Iterator[str]:
    """Yield the answer as text."""
    for run in found.runs:
        files = ", ".join(flight.name for flight in run.flights[:3]) + " ..." * (len(run.flights) > 3)
        yield f"{run.name}: {files}, {run.seconds():.0f} s"
    yield from found.notes
    if found.reason:
        yield f"not comparable: {found.reason}"
        return
    yield from (finding.sentence() for finding in found.findings)
    counts = [sum(one.kind == kind for one in found.findings) for kind in ORDER]
    what = count_of(len(found.compared), "comparison")
    yield f"{counts[0]} worse, {counts[1]} changed, {counts[2]} better in {what}"


def json_lines(found: Comparison) -> Iterator[str]:
    """Yield a JSON line for each finding, and one with the verdict behind them."""
    yield from (json.dumps(finding.record(), ensure_ascii=False) for finding in found.findings)
    about = {"kind": "verdict", "code": found.code, "comparable": not found.reason, "reason": found.reason or None}
    yield json.dumps(about | {"notes": found.notes, "compared": len(found.compared)}, ensure_ascii=False)


def junit(found: Comparison) -> str:
    """Return a JUnit suite: a case for each comparison, what got worse as a failure."""
    worse = {(one.controller, one.measure): one.sentence() for one in found.findings if one.kind == "worse"}
    cases = dict.fromkeys(found.compared, "") | worse | ({("diff", "comparable"): ""} if found.reason else {})
    counts = {"tests": len(cases), "failures": len(worse), "errors": int(bool(found.reason))}
    about = {name: str(count) for name, count in counts.items()}
    suite = ElementTree.Element("testsuite", {"name": "yapp-tables diff", **about})
    for (who, what), failure in cases.items():
        case = ElementTree.SubElement(suite, "testcase", classname=who, name=what)
        if failure:
            ElementTree.SubElement(case, "failure", message=failure)
        elif who == "diff":
            ElementTree.SubElement(case, "error", message=f"not comparable: {found.reason}")
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True)


def page(found: Comparison) -> str:
    """Return a page with the findings, and each value of each controller by speed, both runs side by side."""
    parts = [pages.listed([("", text) for text in lines(found)][: 2 + len(found.notes)])]
    if found.reason:
        parts.append(f"<p class=worse>not comparable: {html.escape(found.reason)}</p>")
        return pages.page("Two runs compared", parts)
    parts.append(pages.listed([(one.kind, one.sentence()) for one in found.findings] or [("", "nothing differs")]))
    for pair in found.pairs:
        if pair.loads is None or not pair.sides[0].speed():
            continue
        bins, speed = bins_of_both(pair.loads), np.concatenate([load.speed for load in pair.loads])
        bins = np.where(bins >= 0, bins // 16, -1)
        for name in pair.sides[0].names("value", "A", "W", *DEGREES, "%"):
            rows, values = [], pair.column(name)
            for number in np.unique(bins[bins >= 0]):
                use = (bins == number) & np.isfinite(values)
                own = [values[use & (pair.is_after == side)] for side in (False, True)]
                if min(map(len, own)) >= 5:
                    both = [(float(part.mean()), float(part.std())) for part in own]
                    rows.append((f"{speed[use].min():.0f} to {speed[use].max():.0f}", both[0], both[1]))
            if rows:
                about = pair.sides[0].about[name]
                title = html.escape(f"{pair.sides[0].controller}: {about.get('title', name)}")
                parts += [f"<h3>{title}</h3>", pages.pairs(rows, about.get("unit", ""), "speed, RPM")]
    return pages.page("Two runs compared", parts)
