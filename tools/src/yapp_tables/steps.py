# SPDX-License-Identifier: GPL-2.0-or-later
"""How a controller answers a change of its command, what a hold costs, and the log of a thrust stand beside both."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from .changes import command_of, lowest
from .errors import CaptureError, SetupError
from .series import DEGREES, Array, Samples, named, numbers
from .tables import said
from .tshark import Record

LEAST_STEP, HOLD, NEAR = 0.05, 0.5, 0.2  # share of the command's range; seconds; share of the step
LEAST_POINT, SETTLED, LEVEL = 3.0, 1.0, 0.015  # seconds; seconds; share of the largest command
BAND = 0.05  # of the step: what is inside has settled


def followed(found: Mapping[tuple[str, str], Samples]) -> Iterator[tuple[Samples, str, Array, Array]]:
    """Yield each message with a speed: the name of the speed, and times and values of its command."""
    for one in found.values():
        pair = one.speed()
        if pair and len(one.times) > 10:
            when, told = command_of(found, one)
            good = np.isfinite(told)
            if good.any():
                yield one, pair[0], when[good], told[good]


def averaged(about: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the values whose means a point has. about: the metadata of a message's columns."""
    return [name for name in named(about, "value", "A", "V", "W", "RPM") if not name.endswith(("_commanded", "_error"))]


def steps(found: Mapping[tuple[str, str], Samples]) -> Iterator[Record]:
    """Yield a record for each change of a command of LEAST_STEP of its range after which it held."""
    for one, name, when, told in followed(found):
        size, jumps = LEAST_STEP * (told.max() - told.min()), np.abs(np.diff(told, prepend=told[:1], append=told[-1:]))
        # Most of a command that never rests fall out here.
        is_held = (jumps[1:] <= NEAR * jumps[:-1]) | (np.diff(when, append=np.inf) >= HOLD)
        for at in np.flatnonzero((jumps[:-1] > max(size, 1e-9)) & is_held):
            change = told[at] - told[at - 1]
            soon = np.searchsorted(when, when[at] + HOLD)
            if (np.abs(told[at:soon] - told[at]) > NEAR * abs(change)).any():
                continue
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
        # The first sample of those that stay inside.
        inside = max(np.flatnonzero(np.abs(values - 1) > band), default=-1) + 1
        record["overshoot"] = max(0.0, float(values.max()) - 1)
        record["settling_time"] = None if inside == len(times) else float(times[inside]) if inside else 0.0
        record["final_error"] = float(rest.mean() * change) if len(rest) > 1 else None
    return record


def _crossing(times: Array, values: Array, share: float) -> float | None:
    """Return when values reached a share first, on the line between two samples; at least 0."""
    last = max(int(np.searchsorted(times, 0)) - 1, 0)  # before the step
    reached = np.maximum.accumulate(values[last:])
    is_there = len(reached) > 0 and reached[-1] >= share
    return max(0.0, float(np.interp(share, reached, times[last:]))) if is_there else None


def points(found: Mapping[tuple[str, str], Samples], bench: "Bench | None" = None) -> Iterator[Record]:
    """Yield a record for each hold of LEAST_POINT seconds: means behind the first second, slopes in 1/min."""
    for one, speed, when, told in followed(found):
        names, degrees = averaged(one.about), one.names("value", *DEGREES)
        for first, last in _holds(when, told, LEVEL * max(float(np.abs(told).max()), 1e-9)):
            begin, end = when[first] + SETTLED, when[last]
            use = _between(one.times, begin, end)
            if use.stop - use.start < 5:
                continue
            record = _who(one, speed, when[first]) | {"command": float(np.mean(told[first : last + 1]))}
            record |= {"length": float(end - when[first]), "messages": use.stop - use.start}
            record |= {name: _mean(one.columns[name][use]) for name in names}
            for name in degrees:
                values = one.columns[name][use]
                good = np.isfinite(values)
                if good.sum() > 4:
                    since = one.times[use][good] - one.times[use][good].mean()
                    record[f"{name}_slope"] = 60 * float(since @ values[good] / (since @ since))
            if bench and bench.controller == one.controller:
                its = _between(bench.times, begin, end)
                record |= {name: _mean(values[its]) for name, values in bench.columns.items()}
            yield record


def _between(times: Array, begin: float, end: float) -> slice:
    return slice(int(np.searchsorted(times, begin)), int(np.searchsorted(times, end, side="right")))


def _holds(when: Array, told: Array, level: float) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each stretch in which a command stays within a level of its first value."""
    first, times, values = 0, when.tolist(), told.tolist()  # a list is read faster than an array
    for at in range(1, len(values) + 1):
        if at == len(values) or abs(values[at] - values[first]) > level or times[at] - times[at - 1] > LEAST_POINT:
            if times[at - 1] - times[first] >= LEAST_POINT:
                yield first, at - 1
            first = at


def _mean(values: Array) -> float | None:
    known = values[np.isfinite(values)]  # a tenth of the time of nanmean
    return float(known.mean()) if len(known) else None


def point_columns(messages: Mapping[str, pa.Schema]) -> Iterator[Record]:
    """Yield the columns of points besides the fixed ones: of the catalogue's messages with a command."""
    for schema in messages.values():
        about = {each.name: said(each.metadata) for each in schema}
        if any(name.endswith("_commanded") for name in about):
            for name in averaged(about):
                text, unit = f"its mean: {about[name]['title']}", about[name]["unit"]
                yield {"name": name, "type": "number", "help": text, "unit": unit}
            for name in named(about, "value", *DEGREES):
                text, unit = f"how fast it rose: {about[name]['title']}", f"{about[name]['unit']}/min"
                yield {"name": f"{name}_slope", "type": "number", "help": text, "unit": unit}


# ---- the log of a thrust stand

GRID = 0.05  # seconds of the grid on which speeds are compared
LEAST, BETWEEN, SECOND = 0.9, 2.0, 0.97  # correlation; seconds between two offsets; of the best correlation
LEAST_SECONDS, LEAST_ROWS = 5.0, 20
UNITS = {r"(\b|_)ms\b|milli": 1e3, r"(\b|_)[uµ]s\b|micro": 1e6, r"(\b|_)min": 1 / 60}  # of a second
LONGEST = 86400.0  # seconds of a log


@dataclass(frozen=True)
class Bench:
    """A log in the time of the capture. controller: whose speed it has; times: (n) seconds; columns: {name: (n)};
    said: the offset as a sentence."""

    controller: str
    times: Array
    columns: dict[str, Array]
    said: str


def read(path: Path) -> tuple[Array, Array, dict[str, Array]]:
    """Return times in seconds from the first row, speeds, and all columns of numbers, of a CSV. Raises SetupError."""
    try:
        with path.open("rb") as file:
            head, sample = file.readline(), file.read(4096)
        mark = max(",;\t", key=lambda mark: head.count(mark.encode()))
        table = csv.read_csv(
            path,
            csv.ReadOptions(encoding="latin-1" if "\ufffd" in head.decode(errors="replace") else "utf-8"),
            csv.ParseOptions(delimiter=mark, invalid_row_handler=lambda _: "skip"),
            csv.ConvertOptions(decimal_point="," if mark != "," and re.search(rb"\d,\d", sample) else "."),
        )
        names = table.schema.names
        columns = {each.name: numbers(table[each.name]) for each in table.schema
                   if pa.types.is_integer(each.type) or pa.types.is_floating(each.type)}  # fmt: skip
    except (OSError, ValueError, KeyError) as error:
        raise SetupError(f"{path} cannot be read: {error}") from error
    time = next((name for name in names if re.match(r"\s*(time|t|timestamp|zeit)(\b|_)|.*_time\b", name, re.I)), "")
    speed = next((name for name in columns if re.search(r"rpm|speed|drehzahl", name, re.I)), "")
    if time in columns:
        times = columns.pop(time) / next((unit for word, unit in UNITS.items() if re.search(word, time, re.I)), 1)
    elif time and pa.types.is_timestamp(kind := table.schema.field(time).type):
        times = table[time].cast(pa.timestamp("ns", kind.tz)).cast(pa.int64()).to_numpy() / 1e9
    else:
        times = np.zeros(0)
    if not speed or len(times) < LEAST_ROWS:
        needs = f"{LEAST_ROWS} rows, a column of time (s, ms, ISO 8601), and one of speed (rpm), all numbers"
        raise SetupError(f"{path} is no log of a bench: it needs {needs}; it has {len(table)} rows of {names}")
    order = np.flatnonzero(np.isfinite(times))
    long = float(np.ptp(times[order])) if len(order) else 0.0
    if not 0 < long <= LONGEST or (np.diff(times[order]) < 0).any():
        raise SetupError(f"{path}: {time!r} has to rise, to {long:g} s: cut the log, or name the unit, as in time_ms")
    plain = {name: re.sub(r"[^0-9a-zA-Z]+", "_", name).strip("_").lower() for name in columns}
    kept = {f"bench_{plain[name]}": values[order] for name, values in columns.items()}
    return times[order] - times[order[0]], columns[speed][order], kept


def aligned(path: Path, found: Mapping[tuple[str, str], Samples]) -> Bench:
    """Return the log of a bench in the time of the capture. Raises CaptureError where no or several offsets fit."""
    times, speed, columns = read(path)
    there, results = np.isfinite(speed), []
    theirs = _grid(times[there], np.abs(speed[there]))
    for one in found.values():
        pair = one.speed()
        if pair and one.times[-1] - one.times[0] > LEAST_SECONDS:
            own = np.abs(one.columns[pair[0]])
            good = np.isfinite(own)
            for fit, offset in _fits(_grid(one.times[good], own[good]), theirs):
                results.append((fit, offset + one.times[good][0] - times[there][0], one.controller))
    results.sort(key=lambda each: -each[0])
    if not results or results[0][0] < LEAST:
        best = f"; the best correlation is {results[0][0]:.2f}" if results else ""
        raise CaptureError(f"{path}: its speed fits no controller{best}, {LEAST} is needed: is it of this run?")
    fit, offset, who = results[0]
    for other, where, whose in results[1:]:
        if other > SECOND * fit and (whose != who or abs(where - offset) > BETWEEN):
            raise CaptureError(
                f"{path}: ambiguous, offsets of {offset:.2f} s on {who} and {where:.2f} s on {whose} fit alike "
                f"({fit:.3f}, {other:.3f}): log a step of the speed that comes once, or cut the log"
            )
    said = f"{path.name} begins {offset:+.3f} s from the first message (correlation {fit:.3f} with the speed of {who})"
    return Bench(who, times + offset, columns, said)


def _grid(times: Array, values: Array) -> Array:
    return np.asarray(np.interp(np.arange(times[0], times[-1], GRID), times, values))


def _fits(own: Array, theirs: Array) -> list[tuple[float, float]]:
    """Return (correlation, offset in seconds) of the best offset, and of the best one further than BETWEEN from it."""
    size = 1 << (len(own) + len(theirs)).bit_length()

    def sums(a: Array, b: Array) -> Array:
        found = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.concatenate([found[size - len(theirs) + 1 :], found[: len(own)]])

    own, theirs = own / max(own.max(), 1e-9), theirs / max(theirs.max(), 1e-9)
    ones = np.ones(len(own)), np.ones(len(theirs))
    count = np.maximum(np.round(sums(*ones)), 1)
    first, second = sums(own, ones[1]) / count, sums(ones[0], theirs) / count
    spread = (sums(own**2, ones[1]) / count - first**2) * (sums(ones[0], theirs**2) / count - second**2)
    fit = (sums(own, theirs) / count - first * second) / np.sqrt(np.maximum(spread, 1e-9))
    fit[count < min(len(own), len(theirs)) / 2] = -1
    found = []
    for _ in range(2):
        at = int(np.argmax(fit))
        found.append((float(min(fit[at], 1.0)), (lowest(-fit) - (len(theirs) - 1)) * GRID))
        fit[max(0, at - int(BETWEEN / GRID)) : at + int(BETWEEN / GRID) + 1] = -1
    return found
