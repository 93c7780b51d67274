# SPDX-License-Identifier: GPL-2.0-or-later
"""Which controller is different from the others of its message: the rules that docs/tables.md states."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from .series import Array, Source, numbers
from .tables import Column, Message

Record = dict[str, Any]
DEGREES, SECONDS = 10.0, 20  # a temperature apart from the others, for so long
FOLLOWS, SHARE = 2.0, 0.002  # times worse than the others, and of the largest command
LOAD, SPREADS = 1.25, 4.0  # times the others' level, and further away than they lie apart
SURGE, STEPS = 1.8, 2  # times the others' value at the same moment, for so many messages
APART = 0.1  # and by this share of the largest value of a flight
ABSENT = 0.95  # of all samples
AROUND = 10.0  # seconds before and after a fault


def differing(message: Message, found: list[Source], alarms: set[str]) -> list[Record]:
    """Return {source, text, at} of each controller that is different; at: in seconds since the report's start.

    alarms: flags that are faults. How a controller follows its command around a fault does not count.
    """
    said: list[Record] = []
    names = [name for name, column in message.columns.items() if column.role == "value"]
    names = [name for name in names if name in found[0].rows.schema.names]
    for name in names if len(found) > 1 else ():
        title, unit = message.columns[name].title, message.columns[name].unit
        values = [numbers(source.rows[name]) for source in found]
        said += _absent(found, name, title)
        if unit in ("°C", "C", "degC"):
            said += _temperature(found, values, title)
        elif name.endswith("_measured") and (command := name.replace("_measured", "_commanded")) in names:
            said += _following(found, values, [_commands(source, command, alarms) for source in found], title)
        elif unit in ("A", "V", "W"):
            said += _level(found, values, title, unit)
    return said


def _absent(found: list[Source], name: str, title: str) -> list[Record]:
    """Name those that say "not connected" (the reserved value NaN) all the time, where others have a value."""
    special = f"{name}_special"
    if special not in found[0].rows.schema.names:
        return []
    shares = [np.mean(np.asarray(source.rows[special].to_pylist(), object) == "nan") for source in found]
    if min(shares) > 1 - ABSENT:
        return []
    text = f"{title} not connected, whole flight"
    return [_said(source, text, source.times[0]) for source, share in zip(found, shares, strict=True) if share > ABSENT]


def _temperature(found: list[Source], values: list[Array], title: str) -> list[Record]:
    grid = _by_second(found, values)
    said = []
    for number, source in enumerate(found):
        others = np.delete(grid, number, axis=0)
        for sign, word in ((1, "hotter"), (-1, "cooler")):
            if sign < 0 and len(found) == 2:  # of two, the hot one is said
                continue
            away = sign * (grid[number] - _typical(others, sign))
            for begin, end in _runs(away > DEGREES)[:1]:
                what = "the median of the others" if len(found) > 2 else "the other one"
                until = "on" if end >= source.times[-1] - 5 else f"to {end} s"
                text = f"{title} {np.nanmedian(away[begin:end]):.0f} °C {word} than {what} from {begin} s {until}"
                said.append(_said(source, text, float(begin)))
    return said


def _runs(holds: Array, least: int = SECONDS) -> list[tuple[int, int]]:
    """Return begin and end of each stretch of so many or more, the longest first."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    found = [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
    return sorted((run for run in found if run[1] - run[0] >= least), key=lambda run: run[0] - run[1])


def _commands(source: Source, name: str, alarms: set[str]) -> Array:
    """Return what a controller was told; NaN around its faults."""
    command = numbers(source.rows[name])
    for flag in alarms:
        at = source.times[numbers(source.rows[flag]) > 0]
        after = np.searchsorted(at, source.times, side="right")
        since = source.times - np.concatenate([[-np.inf], at])[after]
        until = np.concatenate([at, [np.inf]])[after] - source.times
        command = np.where((since < AROUND) | (until < AROUND), np.nan, command)
    return command


def _following(found: list[Source], values: list[Array], commands: list[Array], title: str) -> list[Record]:
    """Compare the mean distance from the command; its largest 2 % do not count: a fault is said elsewhere."""
    errors = []
    for measured, command in zip(values, commands, strict=True):
        away = np.sort(np.abs(measured - command)[np.isfinite(measured - command)])
        errors.append(float(away[: int(len(away) * 0.98)].mean()) if len(away) > 50 else np.nan)
    finite = [np.nanmax(np.abs(command)) for command in commands if np.isfinite(command).any()]
    least = SHARE * max(finite, default=0.0)
    said = []
    for number, source in enumerate(found):
        others = float(_typical(np.delete(errors, number)[:, None], 1)[0])
        if errors[number] > max(FOLLOWS * others, least) and others > 0:
            text = f"{title} follows its command {errors[number] / others:.1f} times worse than the others"
            said.append(_said(source, text, source.times[0]))
    return said


def _level(found: list[Source], values: list[Array], title: str, unit: str) -> list[Record]:
    """Compare the median of the flight; it needs three others that agree."""
    levels = np.array([np.nanmedian(each) if np.isfinite(each).any() else np.nan for each in values])
    said = []
    for number, source in enumerate(found if len(found) > 3 else ()):
        others = np.delete(levels, number)
        middle, apart = float(np.nanmedian(others)), float(np.nanmax(others) - np.nanmin(others))
        away = levels[number] - middle
        if abs(away) > max((LOAD - 1) * abs(middle), SPREADS * apart) and abs(away) > 1:
            word = "higher" if away > 0 else "lower"
            text = f"{title} {abs(away):.3g} {unit} {word} than the median of the others"
            said.append(_said(source, text, source.times[0]))
    return said


def surges(found: list[Source], values: list[Array], column: Column) -> list[Record]:
    """Return {source, text, at, end, times} of who had a multiple of what the others had at the same moment."""
    if len(found) < 3:
        return []
    every = max(source.every for source in found)
    size = int(max(source.times[-1] for source in found) / every) + 2
    grid = np.full((len(found), size), np.nan)
    for row, source, own in zip(grid, found, values, strict=True):
        row[np.maximum(0, np.rint(source.times / every)).astype(int)] = own
    # A message that comes a bit late leaves a step without a value: the one before stands there.
    grid[:, 1:] = np.where(np.isnan(grid[:, 1:]), grid[:, :-1], grid[:, 1:])
    largest = np.nanmax(np.abs(grid), initial=0.0)
    said = []
    for number, source in enumerate(found):
        others = _typical(np.delete(grid, number, axis=0), 1)
        away = np.abs(grid[number] - others)
        usual = float(np.nanquantile(away, 0.95)) if np.isfinite(away).any() else 0.0
        far = (grid[number] > SURGE * np.abs(others)) & (grid[number] - others > max(APART * largest, 2 * usual))
        runs = _runs(far, STEPS)
        if runs:
            begin, end = runs[0]
            times = float(np.median(grid[number][begin:end] / np.maximum(others[begin:end], 1e-9)))
            peak = float(np.nanmax(grid[number][begin:end]))
            text = f"{column.title} {peak:.3g} {column.unit}, {times:.1f} times the others'"
            text += f" for {(end - begin) * every:.2g} s"
            more = f", and {len(runs) - 1} times more" if len(runs) > 1 else ""
            about = {"times": times, "end": end * every, "length": (end - begin) * every}
            said.append(_said(source, text + more, begin * every) | about)
    return said


def _typical(others: Array, sign: int) -> Array:
    """Return the median of three or more; of fewer the one that is nearest to what is far away."""
    with warnings.catch_warnings(action="ignore"):
        if len(others) > 2:
            known = np.where(np.isfinite(others).sum(axis=0) > 1, 1.0, np.nan)
            return np.asarray(np.nanmedian(np.where(np.isfinite(others), others, np.nan), axis=0) * known)
        return np.asarray(sign * np.max(sign * others, axis=0))


def _by_second(found: list[Source], values: list[Array]) -> Array:
    """Return the mean of each source and second, the one before where there is none; NaN after five seconds."""
    length = int(max(source.times[-1] for source in found)) + 1
    grid = np.full((len(found), length), np.nan)
    for row, source, each in zip(grid, found, values, strict=True):
        good = np.isfinite(each) & (source.times >= 0)
        at = source.times[good].astype(int)
        count = np.bincount(at, minlength=length)
        total = np.bincount(at, each[good], minlength=length)
        last = np.maximum.accumulate(np.where(count > 0, np.arange(length), -1))
        known = (last >= 0) & (np.arange(length) - last <= 5)
        row[known] = (total / np.maximum(count, 1))[last[known]]
    return grid


def _said(source: Source, text: str, at: float) -> Record:
    return {"source": source.name, "text": text, "at": float(at)}
