# SPDX-License-Identifier: GPL-2.0-or-later
"""Two runs, one verdict: whether they can be compared, then what got worse, better, or is another. docs/compare.md."""

import html
import json
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from . import pages
from .changes import BLOCK, LEAST_BLOCKS, Change, Following, Load, change, comparable, dependent, more_often, responses
from .errors import count_of, progress
from .flight import Flight, read_flight
from .incidents import EVENTS, events_of
from .series import APART, DEGREES, Array, Samples, joined, samples, source_name
from .tshark import Record, Tshark

LEAST_SECONDS, LEAST_COMMON = 20.0, 0.3  # of a run; share of its samples at loads of both
CHANCE, CHANCE_OF_EVENTS = 0.02, 0.04  # that one of all comparisons is called worse by chance
LEAST_OF_ALL = 0.02  # of a multiple that all controllers have: it may be the wind
MANY = 3  # flights of each side, over which wind and weather are even
ALIKE = "it may be the weather: three flights of each side would tell"
BURST = 2.0  # seconds in which losses count once
PACKETS = "30000"  # of a capture, whose sizes are compared: of all, it takes three times as long as the rest
ORDER = {"worse": 0, "changed": 1, "better": 2}
NUMBERS = ("before", "after", "change", "low", "high")  # values of both runs, their change, and its 95 % interval


@dataclass(frozen=True)
class Kind:
    """A kind of value. least: the least change that counts, relative where it is a multiple, else in the unit."""

    least: float
    is_multiple: bool = False
    worse: int = 1  # the sign of a change that is worse


KINDS = {
    "A": Kind(0.015, is_multiple=True),
    "°C": Kind(1.5),
    "%": Kind(2.0),
    "jitter": Kind(0.3, is_multiple=True),
    "rate": Kind(0.02, is_multiple=True, worse=-1),
    "lag": Kind(20.0),
    "share": Kind(5.0),
}


@dataclass
class Run:
    """One side: its flights, their messages by (controller, message), and what tshark says of them."""

    name: str
    flights: list[Flight] = field(default_factory=list)
    seconds: float = 0.0  # of the flights, without the time between them
    samples: dict[tuple[str, str], Samples] = field(default_factory=dict)
    events: list[Record] = field(default_factory=list)
    sizes: dict[tuple[str, str], set[int]] = field(default_factory=lambda: defaultdict(set))
    verdicts: list[Record] = field(default_factory=list)

    def where(self, one: Samples, at: int) -> Record:
        """Return file, frame and time of a sample."""
        flight = self.flights[int(one.times[at] // APART)]
        return {"file": flight.name, "frame": int(one.frames[at]), "time": round(float(one.times[at] % APART), 3)}


class Pair:
    """A message of a controller in both runs. times, is_after, every (all true): (n), of BEFORE, then of AFTER.

    loads: of both runs, of the controller; None where its speed is unknown.
    """

    def __init__(self, runs: tuple[Run, Run], sides: tuple[Samples, Samples]) -> None:
        """Put the times of both behind each other."""
        self.runs, self.sides, self.loads = runs, sides, [Load.of(one) for one in sides]
        self.controller, self.title = sides[0].controller, sides[0].title
        self.times = np.concatenate([one.times for one in sides])
        self.is_after = np.repeat([False, True], [len(one.times) for one in sides])
        self.every = np.ones(len(self.times), bool)

    def load(self) -> Load | None:
        """Return the load at the times of both."""
        both = [vars(load.at(one.times)).values() for load, one in zip(self.loads, self.sides, strict=True) if load]
        return Load(*map(np.concatenate, zip(*both, strict=True))) if len(both) == 2 else None

    def column(self, name: str) -> Array:
        """Return the values of both, (n)."""
        return np.concatenate([one.columns[name] for one in self.sides])

    def change(self, values: Array, good: Array, load: Array | None = None) -> Change | None:
        """Return how much higher the good values are AFTER."""
        return change(self.times, np.where(good, values, np.nan), self.is_after, load)

    def typical(self, good: Array, values: Array) -> list[Record]:
        """Return where each run has the good value that is nearest to its own median."""
        places = []
        for run, own, its in zip(self.runs, self.sides, (~self.is_after, self.is_after), strict=True):
            away = np.abs(values[its] - np.median(values[its & good]))
            places.append(run.where(own, int(np.argmin(np.where(good[its], away, np.inf)))))
        return places


def _finding(kind: str, who: str, measure: str, text: str, at: Sequence[Record] = ({}, {}), **more: Any) -> Record:
    """Return what differs, as a JSON line. kind: a word of ORDER; at: where it shows, of both runs; more: NUMBERS."""
    row: Record = {"kind": kind, "controller": who, "measure": measure, "text": text, "unit": "", "weight": 1.0}
    row |= dict.fromkeys(NUMBERS) | more
    for side, its in zip(("before", "after"), at, strict=True):
        row |= {f"{side}_{name}": its.get(name) for name in ("file", "frame", "time")}
    return row


def _sentence(row: Record) -> str:
    sides = [side for side in ("before", "after") if row[f"{side}_frame"]]
    where = ", ".join(f"{side} frame {row[f'{side}_frame']} at {row[f'{side}_time']:.3f} s" for side in sides)
    return f"{row['kind']}: {row['controller']}: {row['text']}{f' ({where})' if where else ''}"


@dataclass
class Comparison:
    """reason: why the runs cannot be compared, empty where they can; notes: what to know of the answer."""

    runs: tuple[Run, Run]
    pairs: list[Pair] = field(default_factory=list)
    reason: str = ""
    findings: list[Record] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    compared: list[tuple[str, str]] = field(default_factory=list)

    @property
    def code(self) -> int:
        """20 if something got worse, 21 if that could not be judged, 0 otherwise."""
        if any(row["kind"] == "worse" for row in self.findings):
            return 20
        return 21 if self.reason or any(flight.left_out for run in self.runs for flight in run.flights) else 0


def compare(before: Sequence[Path], after: Sequence[Path], tshark: Tshark, rules: Path | None = None) -> Comparison:
    """Return what differs between two runs, each of one or several captures. Raises YappError."""
    text = rules.read_text(encoding="utf-8", errors="replace") if rules else ""
    found = Comparison((_read("BEFORE", before, tshark, text), _read("AFTER", after, tshark, text)))
    for run in found.runs:
        said = dict.fromkeys(text for flight in run.flights for text in flight.left_out)
        found.notes += [f"{run.name}: {text}" for text in said]
    found.reason = _reason(found)
    if not found.reason:
        ways = _at_load, _absent, _intervals, _lag
        measured = [one for way in ways for pair in found.pairs for one in way(pair)]
        found.compared += [(one.controller, one.title) for one in measured]
        ones = [pair.sides[0] for pair in found.pairs]
        wanted = {(one.controller, one.title_of(name)) for one in ones for name, _ in dependent(one)}
        if left := sorted(f"{title} of {who}" for who, title in wanted - set(found.compared)):
            found.notes.append(f"not compared, with too few numbers or with both signs: {', '.join(left)}")
        is_many = min(len(run.flights) for run in found.runs) >= MANY
        found.findings = [*_judged(measured, is_many), *_events(found), *_interface(found), *_rules(found)]
        found.findings.sort(key=lambda row: (ORDER[row["kind"]], -row["weight"]))
    return found


def _read(name: str, captures: Sequence[Path], tshark: Tshark, rules: str) -> Run:
    found, run = [], Run(name)
    for number, capture in enumerate(progress(captures, unit=" flights", desc=name)):
        flight = read_flight(capture, tshark, has_begin=True)
        start, own = flight.start(), samples(flight, number, flight.start())
        run.flights.append(flight)
        run.seconds += max(float(np.ptp(one.times)) for one in own.values())
        found.append(own)
        keys = {ids: key for key, one in own.items() for ids in one.ids}
        for event in events_of(flight.events, flight.messages, start):
            whose, _ = keys.get((event["bus"], event["id"]), (event["who"], ""))
            at = {"file": flight.name, "frame": event["frame"], "time": round(event["at"], 3)}
            run.events.append(event | {"who": whose, "at": at})
        fields = ["-T", "fields", "-E", "occurrence=l", "-e", "yapp.bus", "-e", "yapp.id", "-e", "yapp.size"]
        for line in set(tshark.run(capture, ["-c", PACKETS, "-Y", "yapp.size", *fields]).splitlines()):
            bus, ident, size = line.split("\t")
            if key := keys.get((bus or None, int(ident, 0))):
                run.sizes[key].add(int(size))
        if rules:
            run.verdicts += tshark.ask(capture, ["check,rules=rules,json"], rules)[0]
    run.samples = joined(found)
    return run


def _reason(found: Comparison) -> str:
    """Return why the runs cannot be compared; empty where they can, with their pairs, and what they have in common."""
    before, after = found.runs
    for run in found.runs:
        if run.seconds < LEAST_SECONDS:
            return f"{run.name} lasts {run.seconds:.3g} s; {LEAST_SECONDS:g} s are needed"
    sides = {key: [run for run in found.runs if key in run.samples] for key in before.samples | after.samples}
    only = [f"{key[0]} ({runs[0].samples[key].title}) is in {runs[0].name} only"
            for key, runs in sides.items() if len(runs) == 1]  # fmt: skip
    if only:
        return f"the controllers differ: {'; '.join(only[:4])}; name them alike with -o yapp.sources"
    found.pairs = [Pair(found.runs, (one, after.samples[key])) for key, one in before.samples.items()]
    leads = {pair.controller: pair for pair in found.pairs if all(pair.loads)}
    for pair in found.pairs:
        pair.loads = leads.get(pair.controller, pair).loads
    shares = []
    for pair in leads.values():
        if load := pair.load():
            common, moving = load.common(pair.is_after), load.bins() >= 0
            shares.append([common[its].sum() / moving[its].sum() if moving[its].any() else np.nan
                           for its in (~pair.is_after, pair.is_after)])  # fmt: skip
    for run, own in zip(found.runs, zip(*shares, strict=True), strict=False):
        if np.isnan(own).all():
            return f"no motor turned in {run.name}, or speed or voltage are reserved"
    if shares:
        low, high = np.nanmedian(shares, axis=0)
        both = f"{low:.0%} of BEFORE and {high:.0%} of AFTER are at a speed and voltage that both have"
        if min(low, high) < LEAST_COMMON:
            return f"too few loads in common: {both}; fly the same manoeuvres"
        found.notes.append(both)
    return ""


@dataclass
class _Measured:
    """A value of a controller in both runs. kind: a key of KINDS; base: the value BEFORE, in the unit;
    beside: the change beyond what two or more others have."""

    controller: str
    title: str
    unit: str
    kind: str
    change: Change
    base: float
    at: list[Record]
    beside: Change | None = None


def _absent(pair: Pair) -> Iterator[_Measured]:
    """Compare how many values are reserved, or of a current 0 while the motor turns, as of a sensor that fails."""
    one, load = pair.sides[0], pair.load()
    for name in one.names("value", "A", "V", "RPM", "%", *DEGREES):
        values = pair.column(name)
        is_zero = (values == 0) & load.common(pair.is_after) if load and one.unit_of(name) == "A" else ~pair.every
        absent = 100.0 * (is_zero | ~np.isfinite(values))
        if absent.any() and (result := pair.change(absent, pair.every)) and not name.endswith("_error"):
            title, base = f"absent values of {one.title_of(name)}", float(absent[~pair.is_after].mean())
            yield _Measured(pair.controller, title, "%", "share", result, base, pair.typical(pair.every, absent))


def _at_load(pair: Pair) -> Iterator[_Measured]:
    """Compare each value at equal load."""
    one, load = pair.sides[0], pair.load()
    for name, kind in dependent(one):
        values = pair.column(name)
        terms, good = None, np.isfinite(values)
        if load:
            unit = max(float(np.nanmax(load.speed, initial=1.0)), 1.0)
            terms, good = load.curve(unit, kind == "°C"), good & load.common(pair.is_after)
        shown, good = comparable(values, good, kind)
        if result := pair.change(shown, good, terms):
            usual = [_usual(pair, side, name, kind == "A") for side in (0, 1) if kind != "%"]
            beside = pair.change(shown - np.concatenate(usual), good, terms) if usual and all(map(len, usual)) else None
            base = float(values[good & ~pair.is_after].mean())
            title, unit_ = one.title_of(name), one.unit_of(name)
            yield _Measured(pair.controller, title, unit_, kind, result, base, pair.typical(good, values), beside)


def _usual(pair: Pair, side: int, name: str, is_multiple: bool) -> Array:
    """Return how far the others are from their levels BEFORE, their median, at the times of one controller.

    Empty where there are fewer than two others. Wind and weather are the same for all: what one has beyond the others
    shows sooner. Each has its own level, as the median of levels would jump where two swap places.
    """
    lines, own = [], pair.sides[side]
    for (who, message), one in pair.runs[side].samples.items():
        if message == own.message and who != own.controller:
            good = np.isfinite(one.columns[name])
            level = float(np.nanmedian(pair.runs[0].samples[who, message].columns[name]))
            if good.sum() > 50 and (level > 0 or not is_multiple):
                values = np.interp(own.times, one.times[good], one.columns[name][good])
                lines.append(np.log(np.maximum(values, 1e-9) / level) if is_multiple else values - level)
    return np.asarray(np.median(lines, axis=0)) if len(lines) > 1 else np.zeros(0)


def _intervals(pair: Pair) -> Iterator[_Measured]:
    """Compare the period, and how much single intervals differ from it; silences and losses are events."""
    if min(len(one.times) for one in pair.sides) < 50:
        return
    gaps = np.concatenate([one.gaps() for one in pair.sides])
    periods = [float(np.nanmedian(gaps[its])) for its in (~pair.is_after, pair.is_after)]
    period = np.where(pair.is_after, periods[1], periods[0])
    good = np.isfinite(gaps) & (gaps < 1.7 * period)
    at = pair.typical(good, gaps)
    # Of the means, not of logarithms: a larger jitter is no other rate.
    if longer := pair.change(gaps, good):
        mean = float(gaps[good & ~pair.is_after].mean())
        rate = Change(-math.log1p(longer.value / mean), longer.error / (mean + longer.value), longer.freedom)
        yield _Measured(pair.controller, f"rate of {pair.title}", "Hz", "rate", rate, 1 / mean, at)
    keys, block = np.unique(np.floor(pair.times / BLOCK) * 2 + pair.is_after, return_inverse=True)
    count = np.bincount(block, good)
    spread = np.bincount(block, np.where(good, np.abs(gaps - period), 0.0)) / np.maximum(count, 1)
    known = (count > 0.5 * BLOCK / max(periods)) & (spread > 1e-6)
    is_after, logs = keys[known] % 2 > 0, np.log(spread[known])
    if jitter := change(keys[known] // 2 * BLOCK, logs, is_after):
        base = float(np.exp(logs[~is_after].mean())) * 1e3
        yield _Measured(pair.controller, f"jitter of {pair.title}", "ms", "jitter", jitter, base, at)


def _lag(pair: Pair) -> Iterator[_Measured]:
    """Compare how long after its command a value follows."""
    runs = [Following.of(run.samples, side) for run, side in zip(pair.runs, pair.sides, strict=True)]
    found = responses([run for run in runs if run]) if all(runs) else []
    if found and min(count for *_, count in found) >= LEAST_BLOCKS:
        (before, first, count), (after, second, many) = found
        result = Change((after - before) * 1e3, math.hypot(first, second) * 1e3, 2 * min(count, many) - 2)
        speed = pair.sides[0].speed() or ("",)
        title = f"response of {pair.sides[0].title_of(speed[0])} to its command"
        yield _Measured(pair.controller, title, "ms", "lag", result, before * 1e3, pair.typical(pair.every, pair.times))


def _judged(measured: list[_Measured], is_many: bool) -> Iterator[Record]:
    """Say which changes lie beyond their interval: that of all comparisons together, and the least that counts.

    What all controllers have in common is one finding. It may be wind and weather: only of many flights it is worse.
    """
    chance = CHANCE / max(1, len(measured))
    groups: dict[tuple[str, str], list[_Measured]] = defaultdict(list)
    for one in measured:
        groups[one.title, one.kind].append(one)
    # By how much it was warmer: what all temperatures that move have in common, the least of them.
    warm = {title: float(np.median([one.change.value for one in group])) for (title, kind), group in groups.items()
            if kind == "°C" and any(one.change.error > 0.02 for one in group)}  # fmt: skip
    weather = min(warm.values(), key=abs) if len(warm) > 1 else 0.0
    for (title, name), group in groups.items():
        kind, cause = KINDS[name], weather if title in warm and name == "°C" else 0.0
        has_peers = all(one.beside for one in group)
        if has_peers:
            values = np.array([one.change.value for one in group])
            middle = float(np.median(values))
            error = 1.25 * float(np.median([one.change.error for one in group])) / math.sqrt(len(group))
            whole = Change(middle - cause, error, min(one.change.freedom for one in group))
            typical = group[int(np.argmin(np.abs(values - middle)))]
            bound = LEAST_OF_ALL if kind.is_multiple else kind.least
            for row in _sure(typical, whole, chance, bound, f"all {len(group)} controllers"):
                yield row if is_many else row | {"kind": "changed", "text": f"{row['text']}; {ALIKE}"}
        bound = LEAST_OF_ALL if name == "A" and not has_peers else kind.least
        for one in group:
            own = one.beside or replace(one.change, value=one.change.value - cause)
            yield from _sure(one, own, chance, bound, one.controller)


def _sure(one: _Measured, change: Change, chance: float, bound: float, who: str) -> Iterator[Record]:
    """Yield the finding of a change that is beyond its interval and the least one."""
    sure_low, sure_high = change.within(chance)
    if sure_low <= 0 <= sure_high or abs(change.value) < bound:
        return
    kind, ends = KINDS[one.kind], [change.value, *change.within()]
    if kind.is_multiple:
        numbers = [math.expm1(end) for end in ends]
        now, percents = one.base * (1 + numbers[0]), [number * 100 for number in numbers]
        text = f"{percents[0]:+.3g} % ({percents[1]:+.3g} to {percents[2]:+.3g} %)"
    else:
        numbers, unit = ends, "points" if one.unit == "%" else one.unit
        now = one.base + numbers[0]
        text = f"{numbers[0]:+.3g} {unit} ({numbers[1]:+.3g} to {numbers[2]:+.3g})"
    text += f", {one.base:.4g} -> {now:.4g} {one.unit}{' at equal load' * (one.kind in ('A', '°C', '%'))}"
    text = f"{one.title} {text}{' beyond the others' * (change is one.beside)}"
    word = "worse" if change.value * kind.worse > 0 else "better"
    known = dict(zip(NUMBERS, (one.base, now, *numbers), strict=True))
    # Its weight is how many times the least change it is.
    yield _finding(word, who, one.title, text, one.at, unit=one.unit, weight=abs(change.value) / bound, **known)


def _events(found: Comparison) -> Iterator[Record]:
    """Compare how often faults, reboots, losses and the like came: new, gone, more often, less often."""
    seconds = found.runs[0].seconds, found.runs[1].seconds
    share = seconds[1] / sum(seconds)
    counts: dict[tuple[str, str], tuple[list[Record], list[Record]]] = defaultdict(lambda: ([], []))
    for side, run in enumerate(found.runs):
        for event in run.events:
            is_raised = event["kind"] == "fault" and event["event"] == "raised"
            if is_raised or not EVENTS[event["kind"]].get("is_other"):
                counts[event["who"], str(event["flag"] or event["kind"])][side].append(event)
    faulty = {who for (who, what), sides in counts.items() if what != "faulted" and (sides[0] + sides[1])[0]["flag"]}
    for who in faulty:  # a state beside the flags
        counts.pop((who, "faulted"), None)
    found.compared += list(counts)
    chance = CHANCE_OF_EVENTS / max(1, len(counts))
    for (who, what), sides in counts.items():
        few, many = (sum(int(event["count"] or 1) for event in side) for side in sides)
        if is_loss := EVENTS[what].get("is_loss"):  # they come in bursts
            few, many = (len({(event["at"]["file"], event["at"]["time"] // BURST) for event in side}) for side in sides)
        is_more = more_often(few, many, share) < chance
        is_less = more_often(many, few, 1 - share) < chance
        kind = "worse" if is_more else "better" if is_less else "changed"
        if kind == "changed" and (few or is_loss):
            continue
        hours = [number / length * 3600 for number, length in zip((few, many), seconds, strict=True)]
        word = "new" if not few else "gone" if not many else "more often" if many > few else "less often"
        doubt = "; too few to tell" if kind == "changed" else ""
        text = f"{what} {word}: {few} -> {many} times, {hours[0]:.3g} -> {hours[1]:.3g} an hour{doubt}"
        weight = many / max(few, 1) + 1 if is_more else 0.5
        at: list[Record] = [next((event["at"] for event in side if event["frame"]), {}) for side in sides]
        known = {"before": hours[0], "after": hours[1], "change": hours[1] - hours[0]}
        yield _finding(kind, who, what, text, at, unit="an hour", weight=weight, **known)


def _interface(found: Comparison) -> Iterator[Record]:
    """Compare IDs, sizes and the meanings of enums. A message that grew takes more of the bus."""
    for pair in found.pairs:
        one, other = pair.sides
        who, at = one.controller, pair.typical(pair.every, pair.times)
        if one.ids != other.ids:
            rows = ([{"bus": bus, "id": ident} for bus, ident in sorted(own.ids, key=str)] for own in pair.sides)
            was, now = (", ".join(map(source_name, own)) for own in rows)
            yield _finding("changed", who, f"ID of {one.title}", f"ID of {one.title} {was} -> {now}", at)
        sizes = [sorted(run.sizes[who, one.message]) for run in pair.runs]
        if sizes[0] != sizes[1] and all(sizes):
            texts = [" and ".join(map(str, own)) for own in sizes]
            grown = max(sizes[1]) - max(sizes[0])
            text = f"size of {one.title} {texts[0]} -> {texts[1]} bytes ({grown:+d})"
            known = {"before": max(sizes[0]), "after": max(sizes[1]), "change": grown, "low": grown, "high": grown}
            kind = "worse" if grown > 0 else "changed"
            yield _finding(kind, who, f"size of {one.title}", text, at, unit="bytes", weight=3.0, **known)
        for name in one.names("enum"):
            title = one.title_of(name)
            old, new = (own.texts.get(name, set()) for own in pair.sides)
            news = [f"{text} is new" for text in sorted(new - old)] + [f"{text} is gone" for text in sorted(old - new)]
            if news:
                yield _finding("changed", who, title, f"{title}: {', '.join(news)}", at)


def _rules(found: Comparison) -> Iterator[Record]:
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
            yield _finding(kind, key[1] or "all", key[0], text, weight=10.0)


def lines(found: Comparison) -> Iterator[str]:
    """Yield the answer as text."""
    for run in found.runs:
        files = ", ".join(flight.name for flight in run.flights[:3]) + " ..." * (len(run.flights) > 3)
        yield f"{run.name}: {files}, {run.seconds:.0f} s"
    yield from found.notes
    if found.reason:
        yield f"not comparable: {found.reason}"
        return
    yield from map(_sentence, found.findings)
    counts = [sum(row["kind"] == kind for row in found.findings) for kind in ORDER]
    what = count_of(len(found.compared), "comparison")
    yield f"{counts[0]} worse, {counts[1]} changed, {counts[2]} better in {what}"


def json_lines(found: Comparison) -> Iterator[str]:
    """Yield a JSON line for each finding, and one with the verdict behind them."""
    yield from (json.dumps(row, ensure_ascii=False) for row in found.findings)
    about = {"kind": "verdict", "code": found.code, "comparable": not found.reason, "reason": found.reason or None}
    yield json.dumps(about | {"notes": found.notes, "compared": len(found.compared)}, ensure_ascii=False)


def junit(found: Comparison) -> str:
    """Return a JUnit suite: a case for each comparison, what got worse as a failure."""
    worse = {(row["controller"], row["measure"]): _sentence(row) for row in found.findings if row["kind"] == "worse"}
    cases = dict.fromkeys(found.compared, "") | worse | ({("diff", "comparable"): ""} if found.reason else {})
    counts = {"tests": f"{len(cases)}", "failures": f"{len(worse)}", "errors": "1" if found.reason else "0"}
    suite = ElementTree.Element("testsuite", counts, name="yapp-tables diff")
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
    parts.append(pages.listed([(row["kind"], _sentence(row)) for row in found.findings] or [("", "nothing differs")]))
    for pair in found.pairs:
        load, one = pair.load(), pair.sides[0]
        if load is None or not one.speed():
            continue
        bins = load.bins() // 16  # of speed; of what stands it is -1
        for name in one.names("value", "A", "W", *DEGREES, "%"):
            rows, values = [], pair.column(name)
            for number in np.unique(bins[bins >= 0]):
                use = (bins == number) & np.isfinite(values)
                own = [values[use & its] for its in (~pair.is_after, pair.is_after)]
                if min(map(len, own)) >= 5:
                    both = [(float(part.mean()), float(part.std())) for part in own]
                    rows.append((f"{load.speed[use].min():.0f} to {load.speed[use].max():.0f}", both[0], both[1]))
            if rows:
                title = html.escape(f"{pair.controller}: {one.title_of(name)}")
                parts += [f"<h3>{title}</h3>", pages.pairs(rows, html.escape(one.unit_of(name)))]
    return pages.page("Two runs compared", parts)
