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

from . import plain_page
from .api import read_flight
from .config import Config
from .errors import SetupError, count_of
from .flight import Flight
from .follow import SHAPES, Following
from .intervals import BLOCK, Change, change, more_often, shift
from .matrix import DEGREES
from .runs import APART, Load, Samples, joined, load_bins, samples, terms
from .scratch import scratch
from .series import Array
from .sources import controllers, source_name

Record = dict[str, Any]
LEAST_SECONDS, LEAST_COMMON = 20.0, 0.3  # of a run; share of its samples at loads of both
CHANCE, CHANCE_OF_EVENTS = 0.02, 0.04  # that one of all comparisons is called worse by chance
# The least change that counts: relative where the unit is a multiple, else in the unit.
LEAST = {"A": 0.015, "W": 0.015, "°C": 1.5, "%": 2.0, "jitter": 0.3, "rate": 0.02, "lag": 0.02, "share": 0.002}
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
    flights: list[Flight]
    samples: dict[tuple[str, str], Samples]
    events: list[Record] = field(default_factory=list)
    sizes: dict[tuple[str, str], set[int]] = field(default_factory=dict)
    verdicts: list[Record] = field(default_factory=list)

    def seconds(self) -> float:
        """Return how long the flights are, without the time between them."""
        longest: dict[int, float] = {}
        for one in self.samples.values():
            for number in np.unique(one.times // APART):
                own = one.times[one.times // APART == number]
                longest[int(number)] = max(longest.get(int(number), 0.0), float(own[-1] - own[0]))
        return sum(longest.values())

    def where(self, one: Samples | None, at: int | None) -> Record:
        """Return file, frame and time of a sample."""
        if one is None or at is None or not len(one.times):
            return {"file": None, "frame": None, "time": None}
        flight = self.flights[int(one.times[at] // APART)]
        return {"file": flight.name, "frame": int(one.frames[at]), "time": round(float(one.times[at] % APART), 3)}


@dataclass
class Finding:
    """What differs. kind: "worse", "better", "changed"; before, after: values in unit; low, high: the 95 % interval
    of the change; weight: how many times the least change that counts; at: where it shows, of both runs."""

    kind: str
    controller: str
    measure: str
    text: str
    unit: str = ""
    before: float | None = None
    after: float | None = None
    change: float | None = None
    low: float | None = None
    high: float | None = None
    weight: float = 1.0
    at: tuple[Record, Record] = ({}, {})

    def record(self) -> Record:
        """Return a JSON line."""
        known = {name: value for name, value in vars(self).items() if name not in ("at", "weight")}
        for side, at in zip(("before", "after"), self.at, strict=True):
            known |= {f"{side}_{name}": at.get(name) for name in ("file", "frame", "time")}
        return known

    def sentence(self) -> str:
        """Return it for people."""
        both = zip(("before", "after"), self.at, strict=True)
        told = [(side, at) for side, at in both if at.get("frame") is not None]
        where = ", ".join(f"{side} frame {at['frame']} at {at['time']:.3f} s" for side, at in told)
        return f"{self.kind}: {self.controller}: {self.text}{f' ({where})' if where else ''}"


@dataclass
class Comparison:
    """reason: why the runs cannot be compared, empty where they can; notes: what to know of the answer."""

    before: Run
    after: Run
    reason: str = ""
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    compared: list[tuple[str, str]] = field(default_factory=list)
    undecoded: bool = False

    @property
    def code(self) -> int:
        """20 if something got worse, 21 if that could not be judged, 0 otherwise."""
        if any(finding.kind == "worse" for finding in self.findings):
            return 20
        return 21 if self.reason or self.undecoded else 0


def captures_of(given: str) -> list[Path]:
    """Return the captures that one side of the command means: a file, a folder, or a pattern. Raises SetupError."""
    path = Path(given)
    names = sorted(map(str, path.iterdir())) if path.is_dir() else sorted(glob.glob(given, recursive=True)) or [given]
    found = [Path(os.path.abspath(name)) for name in names if not Path(name).is_dir()]
    if not found:
        raise SetupError(f"no capture in {given}: name a capture, a folder of them, or a pattern in quotes")
    return found


def compare(before: Sequence[Path], after: Sequence[Path], config: Config, rules: Path | None = None) -> Comparison:
    """Return what differs between two runs, each of one or several captures. Raises YappError."""
    runs = _read("BEFORE", before, config, rules), _read("AFTER", after, config, rules)
    found = Comparison(*runs)
    for run in runs:
        said = dict.fromkeys(text for flight in run.flights for text in flight.left_out)
        found.notes += [f"{run.name}: {text}" for text in said]
        found.undecoded |= any(flight.undecoded or flight.partial for flight in run.flights)
    found.reason = _reason(runs[0], runs[1], found.notes)
    if not found.reason:
        found.findings = [*_values(found), *_events(found), *_interface(*runs), *_rules(*runs)]
        found.findings.sort(key=lambda one: (ORDER[one.kind], -one.weight))
    return found


def _read(name: str, captures: Sequence[Path], config: Config, rules: Path | None) -> Run:
    flights: list[Flight] = []
    found: list[dict[tuple[str, str], Samples]] = []
    run = Run(name, flights, {})
    for number, capture in enumerate(tqdm(captures, desc=name, unit="flight", disable=None, leave=False)):
        tshark, _ = config.of(capture)
        flight = read_flight(capture, tshark, has_begin=True)
        start = flight.begin or min(int(flight[message]["time"][0].value) for message in flight)
        flights.append(flight)
        found.append(samples(flight, number, start))
        own = flight.events.append_column("at", flight.events["time"].cast("int64")).drop_columns(["time"]).to_pylist()
        labels = {(bus, ident): one.controller for one in found[-1].values() for bus, ident in one.ids}
        for event, who in zip(own, controllers(own), strict=True):
            where = event["at"] is not None and (event["at"] - start) / 1e9
            event |= {"flight": number, "at": where or 0.0, "file": flight.name}
            event["who"] = labels.get((event["bus"], event["id"])) or (
                who if isinstance(who, str) else source_name(event)
            )
        run.events += own
        for row in tshark.packets(capture, ("yapp.bus", "yapp.id", "yapp.size")):
            bus, ident, size = row[0] or None, int(row[1], 0), int(row[2])
            known = next((key for key, one in found[-1].items() if (bus, ident) in one.ids), None)
            if known:
                run.sizes.setdefault(known, set()).add(size)
        if rules:
            with scratch() as folder:
                (folder / "rules").write_text(rules.read_text(encoding="utf-8"), encoding="utf-8")
                run.verdicts += tshark.ask(capture, str(folder), ["check,rules=rules,json"])[0]
    run.samples = joined(found)
    return run


def _reason(before: Run, after: Run, notes: list[str]) -> str:
    """Return why the runs cannot be compared; empty where they can, with what is in common in notes."""
    for run in (before, after):
        if run.seconds() < LEAST_SECONDS:
            return f"{run.name} lasts {run.seconds():.3g} s; {LEAST_SECONDS:g} s are needed"
    catalogues = {flight.catalogue for run in (before, after) for flight in run.flights}
    if len(catalogues) > 1:
        return f"the catalogues differ: {' / '.join(sorted(catalogues))}; decode both with the same messages"
    only = [
        f"{who} ({one.samples[who, message].title}) is in {one.name} only"
        for one, other in ((before, after), (after, before))
        for who, message in one.samples
        if (who, message) not in other.samples
    ]
    if only:
        return f"the controllers differ: {'; '.join(only[:4])}; name them alike with -o yapp.sources"
    shares, ranges = [], {before.name: [np.inf, -np.inf], after.name: [np.inf, -np.inf]}
    for lead, other in _leads(before, after):
        loads = _loads(lead, other)
        if loads is None:
            continue
        _, common = terms(loads[0], loads[1], False)
        sides = np.split(common, [len(loads[0].times)])
        bins = bins_of_both(loads)
        runs = np.split(bins >= 0, [len(loads[0].times)])
        shares.append([float(side.sum() / max(run.sum(), 1)) for side, run in zip(sides, runs, strict=True)])
        for run, load, moving in zip((before, after), loads, runs, strict=True):
            if moving.any():
                low, high = ranges[run.name]
                own = load.speed[moving]
                ranges[run.name] = [min(low, float(own.min())), max(high, float(own.max()))]
    if shares:
        low, high = np.median(np.array(shares), axis=0)
        if min(low, high) < LEAST_COMMON:
            speeds = ", ".join(f"{name} {low:.0f} to {high:.0f}" for name, (low, high) in ranges.items())
            return (
                f"too few loads in common: {low:.0%} of BEFORE and {high:.0%} of AFTER have a speed and voltage that "
                f"the other has, too (speeds: {speeds}); fly the same manoeuvres"
            )
        notes.append(f"{low:.0%} of BEFORE and {high:.0%} of AFTER are at loads that both have")
    return ""


def _leads(before: Run, after: Run) -> Iterator[tuple[Samples, Samples]]:
    """Yield the messages of both that tell the speed of a controller."""
    for key, one in before.samples.items():
        if key in after.samples and one.speed():
            yield one, after.samples[key]


def _loads(lead: Samples, other: Samples) -> tuple[Load, Load] | None:
    loads = Load.of(lead), Load.of(other)
    return None if loads[0] is None or loads[1] is None else (loads[0], loads[1])


def bins_of_both(loads: tuple[Load, Load]) -> Array:
    """Return the bins of the samples of both runs, one behind the other."""
    speed, volts = ([getattr(load, name) for load in loads] for name in ("speed", "volts"))
    return load_bins(np.concatenate(speed), np.concatenate(volts))


@dataclass
class _Measured:
    """A value of a controller in both runs."""

    controller: str
    name: str
    title: str
    unit: str
    least: str  # a key of LEAST
    is_multiple: bool
    change: Change
    means: tuple[float, float]
    at: tuple[Record, Record]
    worse: int = 1  # the sign of a change that is worse; 0: neither is
    beside: Change | None = None  # beyond what the others have, where there are two or more


def _values(found: Comparison) -> list[Finding]:
    """Compare values at equal load, intervals between messages, and how a command is followed."""
    before, after = found.before, found.after
    loads = {lead.controller: _loads(lead, other) for lead, other in _leads(before, after)}
    measured: list[_Measured] = []
    for key, one in before.samples.items():
        other = after.samples[key]
        pair = loads.get(one.controller)
        for name in one.names("value"):
            if name in other.columns:
                measured += _value(found, one, other, name, pair)
        measured += _intervals(found, one, other)
        measured += _lag(found, one, other)
        measured += _flags(found, one, other)
    found.compared += [(one.controller, one.title) for one in measured]
    return list(_judged(measured, min(len(before.flights), len(after.flights)) >= MANY))


def _value(
    found: Comparison, one: Samples, other: Samples, name: str, loads: tuple[Load, Load] | None
) -> Iterator[_Measured]:
    """Compare a value at equal load. Speed and supply are the load itself; power follows from current."""
    unit, title = one.about[name].get("unit", ""), one.about[name].get("title", name)
    supply, speed = one.supply(), one.speed()
    if (
        name in (speed or ())
        or name.endswith(("_commanded", "_error"))
        or (supply and (name == supply[0] or unit == "W"))
    ):
        return
    if unit not in ("A", "W", "%", *DEGREES) or not one.names("clock"):
        return
    values, times = (np.concatenate(pair) for pair in (
        (one.columns[name], other.columns[name]), (one.times, other.times)))  # fmt: skip
    is_after = np.repeat([False, True], [len(one.times), len(other.times)])
    load, common = None, np.ones(len(values), bool)
    if loads:
        load, common = terms(loads[0].at(one.times), loads[1].at(other.times), unit in DEGREES)
    good = common & np.isfinite(values)
    is_multiple = unit in ("A", "W") and bool(good.any()) and float((values[good] > 0).mean()) > 0.98
    if unit in ("A", "W") and not is_multiple:
        return  # a current of both signs has no multiple
    if is_multiple:
        good &= values > 0.1 * np.nanmedian(values[good])
    shown = np.log(np.where(good, values, 1.0)) if is_multiple else values
    result = change(times[good], shown[good], is_after[good], None if load is None else load[good])
    if result is None or not good[~is_after].any() or not good[is_after].any():
        return
    base = float(np.mean(values[good & ~is_after]))
    now = base * math.exp(result.value) if is_multiple else base + result.value
    key = "°C" if unit in DEGREES else unit
    at = _typical(found, one, other, good, values)
    usual = [
        _usual(found.before, run, own, name, is_multiple) for run, own in ((found.before, one), (found.after, other))
    ]
    beside = None
    if unit != "%" and len(usual[0]) and len(usual[1]):
        shown = shown - np.concatenate(usual)
        beside = change(times[good], shown[good], is_after[good], None if load is None else load[good])
    yield _Measured(one.controller, name, title, unit, key, is_multiple, result, (base, now), at, beside=beside)


def _usual(before: Run, run: Run, own: Samples, name: str, is_multiple: bool) -> Array:
    """Return how far the others are from their levels BEFORE, their median, at the times of one controller.

    Empty where there are fewer than two others. Wind and weather are the same for all: what one has beyond the others
    shows sooner. Each has its own level, as the median of levels would jump where two swap places.
    """
    lines = []
    for (who, message), one in run.samples.items():
        if message == own.message and who != own.controller and name in one.columns:
            good = np.isfinite(one.columns[name])
            level = float(np.nanmedian(before.samples[who, message].columns[name]))
            if good.sum() > 50 and (level > 0 or not is_multiple):
                values = np.interp(own.times, one.times[good], one.columns[name][good])
                lines.append(np.log(np.maximum(values, 1e-9) / level) if is_multiple else values - level)
    return np.asarray(np.median(lines, axis=0)) if len(lines) > 1 else np.zeros(0)


def _typical(found: Comparison, one: Samples, other: Samples, good: Array, values: Array) -> tuple[Record, Record]:
    """Return where each run has the value that is nearest to its own median."""
    places = []
    for run, own, use in zip((found.before, found.after), (one, other), np.split(good, [len(one.times)]), strict=True):
        part = values[: len(one.times)] if own is one else values[len(one.times) :]
        at = np.flatnonzero(use)
        nearest = at[np.argmin(np.abs(part[at] - np.median(part[at])))] if len(at) else None
        places.append(run.where(own, None if nearest is None else int(nearest)))
    return places[0], places[1]


def _intervals(found: Comparison, one: Samples, other: Samples) -> Iterator[_Measured]:
    """Compare the period, and how much single intervals differ from it; silences and losses are events."""
    gaps = [own.gaps() for own in (one, other)]
    if min(map(len, gaps)) < 50:
        return
    periods = [float(np.nanmedian(own)) for own in gaps]
    times = np.concatenate([one.times[1:], other.times[1:]])
    is_after = np.repeat([False, True], [len(own) for own in gaps])
    whole = np.concatenate(gaps)
    period = np.where(is_after, periods[1], periods[0])
    good = np.isfinite(whole) & (whole < 1.7 * period)
    rate = change(times[good], np.log(np.maximum(whole[good], 1e-6)), is_after[good])
    places = _typical(found, one, other, np.concatenate([[False], good[: len(gaps[0])], [False], good[len(gaps[0]) :]]),
                      np.concatenate([[0.0], gaps[0], [0.0], gaps[1]]))  # fmt: skip
    if rate:
        slower = Change(-rate.value, rate.error, rate.freedom)
        hertz = 1 / periods[0], 1 / periods[1]
        yield _Measured(
            one.controller, "rate", f"rate of {one.title}", "Hz", "rate", True, slower, hertz, places, worse=-1
        )
    away = np.abs(whole - period)
    block = np.floor(times / BLOCK)
    keys, number = np.unique(block * 2 + is_after, return_inverse=True)
    count = np.bincount(number, good)
    spread = np.bincount(number, np.where(good, away, 0.0)) / np.maximum(count, 1)
    known = (count > 0.5 * BLOCK / max(periods)) & (spread > 1e-6)
    sides = keys[known] % 2 > 0
    result = change(keys[known] // 2 * BLOCK, np.log(spread[known]), sides)
    if result:
        means = (
            float(np.exp(np.mean(np.log(spread[known][~sides])))),
            float(np.exp(np.mean(np.log(spread[known][sides])))),
        )
        yield _Measured(one.controller, "jitter", f"jitter of {one.title}", "ms", "jitter", True, result,
                        (means[0] * 1e3, means[1] * 1e3), places)  # fmt: skip


def _lag(found: Comparison, one: Samples, other: Samples) -> Iterator[_Measured]:
    """Compare how long after its command a value follows, with one shape of the response for both runs."""
    pair = one.speed()
    if pair is None or pair[0] not in other.columns:
        return
    runs = Following.of(found.before.samples, one), Following.of(found.after.samples, other)
    if runs[0] is None or runs[1] is None:
        return
    sums = [runs[0].least(shape, LAGS[::5]) + runs[1].least(shape, LAGS[::5]) for shape in range(len(SHAPES))]
    shape = int(np.argmin(sums))
    results = [shift(run.times, partial(run.squares, shape), LAGS) for run in runs if run]
    if results[0] is None or results[1] is None:
        return
    before, first, count = results[0]
    after, second, many = results[1]
    result = Change(after - before, math.hypot(first, second), 2 * min(count, many) - 2)
    title = f"response of {one.about[pair[0]].get('title', pair[0])} to its command"
    at = found.before.where(one, 0), found.after.where(other, 0)
    lags = (before + SHAPES[shape]) * 1e3, (after + SHAPES[shape]) * 1e3
    yield _Measured(one.controller, "lag", title, "ms", "lag", False, result, lags, at)


def _flags(found: Comparison, one: Samples, other: Samples) -> Iterator[_Measured]:
    """Compare the share of time for which a flag of a state was set; faults are events."""
    for name in one.names("flag"):
        both = [own.columns.get(name, np.zeros(0)) for own in (one, other)]
        if name.startswith("fault") or not all(map(len, both)) or not any(np.nanmax(own, initial=0) for own in both):
            continue
        is_after = np.repeat([False, True], list(map(len, both)))
        result = change(np.concatenate([one.times, other.times]), np.concatenate(both), is_after)
        if result:
            first = [np.flatnonzero(own > 0)[:1] for own in both]
            at = [run.where(own, int(where[0]) if len(where) else None) for run, own, where in
                  zip((found.before, found.after), (one, other), first, strict=True)]  # fmt: skip
            shares = float(np.nanmean(both[0])), float(np.nanmean(both[1]))
            title = one.about[name].get("title", name)
            yield _Measured(
                one.controller, name, title, "of the time", "share", False, result, shares, (at[0], at[1]), 0
            )


def _judged(measured: list[_Measured], is_many: bool) -> Iterator[Finding]:
    """Say which changes lie beyond their interval: that of all comparisons together, and the least that counts.

    What all controllers have in common is one finding. It may be wind and weather: only of many flights it is worse.
    """
    chance = CHANCE / max(1, len(measured))
    groups: dict[tuple[str, str], list[_Measured]] = defaultdict(list)
    for one in measured:
        groups[one.name, one.least].append(one)
    weather = _weather(groups)
    for (_, least), group in groups.items():
        values = np.array([one.change.value for one in group])
        # A constant knows no weather.
        cause = weather if least == "°C" and any(map(_moves, group)) else 0.0
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
            bound = LEAST_OF_ALL if one.is_multiple and not has_peers and least in ("A", "W") else LEAST[least]
            yield from _finding(one, one.beside or one.change.less(cause), chance, bound, one.controller)


def _weather(groups: dict[tuple[str, str], list[_Measured]]) -> float:
    """Return by how much it was warmer: what all temperatures that move have in common, the least of them."""
    shifts = [
        float(np.median([one.change.value for one in group]))
        for (_, least), group in groups.items()
        if least == "°C" and any(map(_moves, group))
    ]
    return min(shifts, key=abs) if len(shifts) > 1 else 0.0


def _moves(one: _Measured) -> bool:
    """Return whether a temperature is a measured one: a constant knows no weather."""
    return one.change.error > 0.02


def _finding(one: _Measured, change: Change, chance: float, bound: float, who: str) -> Iterator[Finding]:
    low, high = change.within()
    sure_low, sure_high = change.within(chance)
    if not (sure_low > 0 or sure_high < 0) or abs(change.value) < bound:
        return
    kind = "changed" if not one.worse else "worse" if change.value * one.worse > 0 else "better"
    scale = 1e3 if one.unit == "ms" and not one.is_multiple else 1.0
    if one.is_multiple:
        ratio, ends = math.exp(change.value), (math.exp(low), math.exp(high))
        text = (f"{ratio:.3g} times ({ends[0]:.3g} to {ends[1]:.3g})" if ratio > 1.5 or ratio < 0.67 else
                f"{(ratio - 1) * 100:+.3g} % ({(ends[0] - 1) * 100:+.2g} to {(ends[1] - 1) * 100:+.2g} %)")  # fmt: skip
        numbers = ratio - 1, ends[0] - 1, ends[1] - 1
        now = one.means[0] * ratio
    else:
        numbers = change.value * scale, low * scale, high * scale
        now = one.means[0] + numbers[0]
        percent = one.unit == "of the time"
        unit = "points" if one.unit == "%" else one.unit
        text = f"{numbers[0]:+.3g} {unit} ({numbers[1]:+.3g} to {numbers[2]:+.3g})"
        if percent:
            text = f"set {one.means[0]:.2%} -> {one.means[1]:.2%} of the time"
    if one.unit != "of the time":
        text += f", {one.means[0]:.4g} -> {now:.4g} {one.unit}"
    load = " at equal load" if one.least in ("A", "W", "°C", "%") else ""
    others = " beyond the others" if change is one.beside else ""
    yield Finding(kind, who, one.title, f"{one.title} {text}{load}{others}", one.unit, one.means[0], now, *numbers,
                  weight=abs(change.value) / bound, at=one.at)  # fmt: skip


def _events(found: Comparison) -> Iterator[Finding]:
    """Compare how often faults, reboots, losses and the like came: new, gone, more often, less often."""
    seconds = found.before.seconds(), found.after.seconds()
    share = seconds[1] / sum(seconds)
    counts: dict[tuple[str, str], list[list[Record]]] = defaultdict(lambda: [[], []])
    for side, run in enumerate((found.before, found.after)):
        for event in run.events:
            is_raised = event["kind"] == "fault" and event["event"] == "raised"
            if is_raised or event["kind"] not in OTHER_EVENTS:
                counts[event["who"], str(event["flag"] or event["kind"])][side].append(event)
    for who, _ in [key for key in counts if key[1] == "faulted"]:  # a state beside the flags
        if sum(own == who and any(side and side[0]["kind"] == "fault" for side in sides)
               for (own, _), sides in counts.items()) > 1:  # fmt: skip
            del counts[who, "faulted"]
    found.compared += list(counts)
    for (who, what), sides in counts.items():
        few, many = (sum(int(event["count"] or 1) for event in side) for side in sides)
        clumps = _clumps(sides, seconds)
        more = more_often(few, many, share, clumps)
        less = more_often(many, few, 1 - share, clumps)
        chance = CHANCE_OF_EVENTS / max(1, len(counts))
        hours = [number / length * 3600 for number, length in zip((few, many), seconds, strict=True)]
        at = tuple({"file": side[0]["file"], "frame": side[0]["frame"], "time": round(side[0]["at"], 3)} if side else {}
                   for side in sides)  # fmt: skip
        kind = "worse" if more < chance else "better" if less < chance else "changed"
        if kind == "changed" and (few or what in LOSSES):
            continue
        word = "new" if not few else "gone" if not many else "more often" if many > few else "less often"
        doubt = "; too few to tell" if kind == "changed" else ""
        text = f"{what} {word}: {few} -> {many} times, {hours[0]:.3g} -> {hours[1]:.3g} an hour{doubt}"
        weight = min(many, few + many) / max(few, 1) + 1 if kind == "worse" else 0.5
        yield Finding(kind, who, what, text, "an hour", hours[0], hours[1], hours[1] - hours[0], None, None, weight,
                      (at[0], at[1]))  # fmt: skip


def _clumps(sides: list[list[Record]], seconds: tuple[float, float]) -> float:
    """Return the variance of blocks' counts over their mean, 1 where chance explains it: losses come in bursts."""
    largest = 1.0
    for side, length in zip(sides, seconds, strict=True):
        blocks = max(int(length / 10), 2)
        at = [min(int(event["at"] / 10), blocks - 1) for event in side]
        counts = np.bincount(at, [int(event["count"] or 1) for event in side], minlength=blocks) if at else np.zeros(2)
        if counts.sum() > 3:
            spread = float(counts.var(ddof=1) / counts.mean())
            largest = max(largest, spread if spread > 1 + 3 * math.sqrt(2 / (blocks - 1)) else 1.0)
    return largest


def _interface(before: Run, after: Run) -> Iterator[Finding]:
    """Compare IDs, sizes and the meanings of enums. A message that grew takes more of the bus."""
    for key, one in before.samples.items():
        other, at = after.samples[key], (before.where(one, 0), after.where(after.samples[key], 0))
        if one.ids != other.ids:
            ids = [
                ", ".join(f"{bus or ''} 0x{ident:03x}".strip() for bus, ident in sorted(own.ids, key=str))
                for own in (one, other)
            ]
            yield Finding("changed", key[0], f"ID of {one.title}", f"ID of {one.title} {ids[0]} -> {ids[1]}", at=at)
        sizes = [sorted(run.sizes.get(key, ())) for run in (before, after)]
        if sizes[0] != sizes[1] and all(sizes):
            texts = [" and ".join(map(str, own)) for own in sizes]
            grown = max(sizes[1]) - max(sizes[0])
            text = f"size of {one.title} {texts[0]} -> {texts[1]} bytes ({grown:+d})"
            yield Finding("worse" if grown > 0 else "changed", key[0], f"size of {one.title}", text, "bytes",
                          max(sizes[0]), max(sizes[1]), grown, grown, grown, 3.0, at)  # fmt: skip
        for name in one.names("enum"):
            title = one.about[name].get("title", name)
            was, now = (own.texts.get(name, set()) for own in (one, other))
            if was != now:
                news = [f"{text} is new" for text in sorted(now - was)] + [
                    f"{text} is gone" for text in sorted(was - now)
                ]
                yield Finding("changed", key[0], title, f"{title}: {', '.join(news)}", at=at)


def _rules(before: Run, after: Run) -> Iterator[Finding]:
    """Compare the verdicts on the rules of a file."""
    sides = []
    for run in (before, after):
        found: dict[tuple[str, str], Record] = {}
        for row in run.verdicts:
            key = row["rule"], row["source"] or ""
            if key not in found or found[key]["ok"] is True:  # of several captures the worst
                found[key] = row
        sides.append(found)
    for key, row in sides[1].items():
        was = sides[0].get(key, {"ok": None})["ok"]
        if was != row["ok"]:
            words = {True: "held", False: "did not hold", None: "could not be judged"}
            kind = "worse" if row["ok"] is False else "better" if was is False and row["ok"] else "changed"
            seen = f" (seen {row['seen']}, limit {row['limit']})" if row.get("seen") is not None else ""
            text = f"rule {key[0]} {words[was]}, now {words[row['ok']]}{seen}"
            at = {"frame": row.get("frame"), "time": 0.0, "file": None} if row.get("frame") else {}
            yield Finding(kind, key[1] or "all", key[0], text, weight=10.0, at=({}, at))


def lines(found: Comparison) -> Iterator[str]:
    """Yield the answer as text."""
    for run in (found.before, found.after):
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
    worse = [one for one in found.findings if one.kind == "worse"]
    cases: dict[tuple[str, str], str] = dict.fromkeys(found.compared, "")
    cases |= {(one.controller, one.measure): one.sentence() for one in worse}
    suite = ElementTree.Element("testsuite", name="yapp-tables diff", tests=str(max(len(cases), 1)),
                                failures=str(len(worse)), errors=str(int(bool(found.reason))))  # fmt: skip
    for (who, what), failure in cases.items():
        case = ElementTree.SubElement(suite, "testcase", classname=who, name=what)
        if failure:
            ElementTree.SubElement(case, "failure", message=failure)
    if found.reason:
        case = ElementTree.SubElement(suite, "testcase", classname="diff", name="comparable")
        ElementTree.SubElement(case, "error", message=f"not comparable: {found.reason}")
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True)


def page(found: Comparison) -> str:
    """Return a page with the findings, and each value of each controller by speed, both runs side by side."""
    parts = [plain_page.listed([("", text) for text in lines(found)][: 2 + len(found.notes)])]
    if found.reason:
        return plain_page.page(
            "Two runs compared", [*parts, f"<p class=worse>not comparable: {html.escape(found.reason)}</p>"]
        )
    parts.append(plain_page.listed([(one.kind, one.sentence()) for one in found.findings] or [("", "nothing differs")]))
    for lead, other in _leads(found.before, found.after):
        loads = _loads(lead, other)
        if loads is None:
            continue
        bins = bins_of_both(loads)
        sides = np.split(np.where(bins >= 0, bins // 16, -1), [len(lead.times)])
        for name in lead.names("value", "A", "W", *DEGREES, "%"):
            rows = []
            for number in np.unique(sides[0][sides[0] >= 0]):
                use = [side == number for side in sides]
                own = [one.columns[name][at] for one, at in zip((lead, other), use, strict=True)]
                own = [part[np.isfinite(part)] for part in own]
                if min(map(len, own)) >= 5:
                    speeds = loads[0].speed[use[0]]
                    both = [(float(part.mean()), float(part.std())) for part in own]
                    rows.append((f"{speeds.min():.0f} to {speeds.max():.0f}", both[0], both[1]))
            if rows:
                about = lead.about[name]
                title = html.escape(f"{lead.controller}: {about.get('title', name)}")
                parts += [f"<h3>{title}</h3>", plain_page.pairs(rows, about.get("unit", ""), "speed, RPM")]
    return plain_page.page("Two runs compared", parts)
