# SPDX-License-Identifier: GPL-2.0-or-later
"""Steps and operating points of a flight: how a controller answers a change of its command, what a hold costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .bench import Bench
from .follow import command_of
from .series import DEGREES, Array, Samples

Record = dict[str, Any]
LEAST_STEP, HOLD, NEAR = 0.05, 0.5, 0.2  # share of the command's range; seconds; share of the step
LEAST_POINT, SETTLED, LEVEL = 3.0, 1.0, 0.015  # seconds; seconds; share of the largest command
BAND = 0.05  # of the step: what is inside has settled
WHO = (
    ("time", "time", "when the command changed, or the hold began, UTC", ""),
    ("frame", "integer", "the message of the controller that comes next", ""),
    ("bus", "string", "the bus or line; null where the capture names none", ""),
    ("id", "id", "the message ID", ""),
    ("controller", "string", "the name of the controller, or bus and ID", ""),
    ("message", "string", "the message that has what was measured", ""),
    ("field", "string", "what follows the command", ""),
)
STEPS = (
    *WHO,
    ("before", "number", "the command before, in the field's unit", ""),
    ("after", "number", "the command from then on", ""),
    ("hold", "number", "how long it stayed", "s"),
    ("dead_time", "number", "until 10 % of the change were reached", "s"),
    ("lag", "number", "until 63 %", "s"),
    ("rise_time", "number", "from 10 % to 90 %", "s"),
    ("overshoot", "number", "how far beyond the command, as a share of the change", ""),
    ("settling_time", "number", "until it stayed within 5 % of the change, or its noise; null if it never did", "s"),
    ("final_error", "number", "measured less commanded, mean of the last third of the hold", ""),
    ("resolution", "number", "time between two messages: a time is known no better", "s"),
)
POINTS = (
    *WHO,
    ("command", "number", "the command, in the field's unit", ""),
    ("length", "number", "how long it was held", "s"),
    ("messages", "integer", "how many messages are in the means", ""),
)


def followed(found: Mapping[tuple[str, str], Samples]) -> Iterator[tuple[Samples, str, Array, Array]]:
    """Yield each message with a speed: the name of the speed, and times and values of its command."""
    for one in found.values():
        pair = one.speed()
        if pair and len(one.times) > 10:
            when, told = command_of(found, one)
            good = np.isfinite(told)
            if good.any():
                yield one, pair[0], when[good], told[good]


def measured_names(one: Samples) -> list[str]:
    """Return the values whose means a point has."""
    return [name for name in one.measured("A", "V", "W", "RPM") if not name.endswith("_error")]


def steps(found: Mapping[tuple[str, str], Samples]) -> Iterator[Record]:
    """Yield a record for each change of a command of LEAST_STEP of its range after which it held."""
    for one, name, when, told in followed(found):
        size = LEAST_STEP * (told.max() - told.min())
        for at in np.flatnonzero(np.abs(np.diff(told)) > max(size, 1e-9)) + 1:
            change = told[at] - told[at - 1]
            moved = np.flatnonzero(np.abs(told[at:] - told[at]) > NEAR * abs(change))
            end = when[at + moved[0]] if len(moved) else when[-1]
            if end - when[at] >= HOLD:
                record = {"before": float(told[at - 1]), "after": float(told[at]), "hold": float(end - when[at])}
                yield _who(one, name, when[at]) | record | _answer(one, name, when[at], end, told[at - 1], change)


def _who(one: Samples, field: str, time: float) -> Record:
    bus, number = next(iter(one.ids))
    at = min(int(np.searchsorted(one.times, time)), len(one.times) - 1)
    about = {"at": float(time), "frame": int(one.frames[at]), "bus": bus, "id": number}
    return about | {"source": one.controller, "message": one.message, "field": field}


def _answer(one: Samples, field: str, begin: float, end: float, before: float, change: float) -> Record:
    """Measure a step, by the controller's clock where it has one: a recorder stamps late."""
    use = (one.times >= begin - 3 * one.every) & (one.times <= end) & np.isfinite(one.columns[field])
    times, values = one.times[use], (one.columns[field][use] - before) / change
    for clock in one.names("clock")[:1]:
        own = one.columns[clock][use]
        if len(own) > 2 and np.isfinite(own).all() and (np.diff(own) > 0).all():
            times = own - np.median(own - times)
    times = times - begin
    first, lag, last = (_crossing(times, values, share) for share in (0.1, 0.632, 0.9))
    record: Record = {"dead_time": first, "lag": lag, "resolution": float(one.every)}
    record["rise_time"] = None if first is None or last is None else last - first
    times, values = times[times > 0], values[times > 0]
    if len(times):
        rest = values[times > (end - begin) * 2 / 3] - 1
        # What the value does once it has settled is noise.
        band = max(BAND, 3 * float(rest.std())) if len(rest) > 4 else BAND
        inside = max(np.flatnonzero(np.abs(values - 1) > band), default=-1) + 1  # the first sample from which on it is
        record["overshoot"] = max(0.0, float(values.max()) - 1)
        record["settling_time"] = [0.0, *map(float, times[1:]), None][inside]
        record["final_error"] = float(rest.mean() * change) if len(rest) > 1 else None
    return record


def _crossing(times: Array, values: Array, share: float) -> float | None:
    """Return when values reached a share first, on the line between two samples; at least 0."""
    there = np.flatnonzero((values >= share) & (times >= 0))
    if not len(there):
        return None
    at = int(there[0])
    if at == 0 or values[at - 1] >= share:
        return float(times[at])
    part = (share - values[at - 1]) / (values[at] - values[at - 1])
    return max(0.0, float(times[at - 1] + part * (times[at] - times[at - 1])))


def points(found: Mapping[tuple[str, str], Samples], bench: Bench | None = None) -> Iterator[Record]:
    """Yield a record for each hold of LEAST_POINT seconds: means behind the first second, slopes in 1/min.

    bench: a thrust stand, with the times of the capture.
    """
    for one, speed, when, told in followed(found):
        for first, last in _holds(when, told, LEVEL * max(float(np.abs(told).max()), 1e-9)):
            use = (one.times >= when[first] + SETTLED) & (one.times <= when[last])
            if use.sum() < 5:
                continue
            record = _who(one, speed, when[first]) | {"command": float(np.mean(told[first : last + 1]))}
            record |= {"length": float(when[last] - when[first]), "messages": int(use.sum())}
            record |= {name: _mean(one.columns[name][use]) for name in measured_names(one)}
            for name in one.names("value", *DEGREES):
                good = use & np.isfinite(one.columns[name])
                if good.sum() > 4:
                    line = np.polyfit(one.times[good] / 60, one.columns[name][good], 1)
                    record[f"{name}_slope"] = float(line[0])
            if bench and bench.controller == one.controller:
                its = (bench.times >= when[first] + SETTLED) & (bench.times <= when[last])
                record |= {name: _mean(values[its]) for name, values in bench.columns.items()}
            yield record


def _holds(when: Array, told: Array, level: float) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each stretch in which a command stays within a level of its first value."""
    first = 0
    for at in range(1, len(told) + 1):
        if at == len(told) or abs(told[at] - told[first]) > level or when[at] - when[at - 1] > LEAST_POINT:
            if when[at - 1] - when[first] >= LEAST_POINT:
                yield first, at - 1
            first = at


def _mean(values: Array) -> float | None:
    good = values[np.isfinite(values)]
    return float(good.mean()) if len(good) else None


def point_columns(found: Mapping[tuple[str, str], Samples], bench: Bench | None) -> list[tuple[str, str, str, str]]:
    """Return the columns of points besides POINTS: (name, type, meaning, unit)."""
    columns = {}
    for one, *_ in followed(found):
        for name in measured_names(one):
            columns[name] = name, "number", f"its mean: {one.title_of(name)}", one.unit_of(name)
        for name in one.names("value", *DEGREES):
            about = f"how fast it rose: {one.title_of(name)}", f"{one.unit_of(name)}/min"
            columns[f"{name}_slope"] = f"{name}_slope", "number", *about
    logged = bench.columns if bench else ()
    return [*columns.values(), *((name, "number", "its mean, of the bench's log", "") for name in logged)]
