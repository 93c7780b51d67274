# SPDX-License-Identifier: GPL-2.0-or-later
"""The log of a thrust stand beside a capture: aligned by what both know, the speed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from .errors import SetupError
from .intervals import slope
from .series import Array, Samples, numbers

STEP = 0.05  # seconds of the grid on which speeds are compared
LEAST, APART, SECOND = 0.9, 2.0, 0.97  # correlation; seconds between two offsets; of the best correlation
LEAST_SECONDS = 5.0


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
            sample = file.read(4096)
        parse = csv.ParseOptions(
            delimiter=";" if sample.count(b";") > sample.count(b",") else ",", invalid_row_handler=lambda _: "skip"
        )
        table = csv.read_csv(path, parse_options=parse)
    except (OSError, pa.ArrowInvalid) as error:
        raise SetupError(f"{path} cannot be read: {error}") from error
    if len(table) < 20:
        raise SetupError(f"{path} has {len(table)} rows; a log of a bench has a header and a row for each sample")
    names = table.schema.names
    time = next((name for name in names if re.match(r"\s*(time|t|timestamp)\b|.*_time\b", name, re.I)), None)
    speed = next((name for name in names if re.search(r"rpm|speed|drehzahl", name, re.I)), None)
    if time is None or speed is None:
        what = "time" if time is None else "speed (rpm)"
        raise SetupError(f"{path} has no column of {what}; its columns: {', '.join(names)}")
    is_number = {each.name: pa.types.is_integer(each.type) or pa.types.is_floating(each.type) for each in table.schema}
    columns = {name: numbers(table[name]) for name in names if is_number[name] and name != time}
    if pa.types.is_timestamp(table.schema.field(time).type):
        times = table[time].cast(pa.timestamp("ns", table.schema.field(time).type.tz)).cast(pa.int64()).to_numpy() / 1e9
    elif is_number[time]:
        unit = (
            1e3 if re.search(r"\bms\b|milli", time, re.I) else 1e6 if re.search(r"\b[uµ]s\b|micro", time, re.I) else 1
        )
        times = numbers(table[time]) / unit
    else:
        raise SetupError(f"{path}: {time} is no time: {table[time][0]}; seconds, ms, or ISO 8601 are")
    if speed not in columns:
        raise SetupError(f"{path}: {speed} has cells that are no numbers")
    order = np.argsort(times, kind="stable")[: np.isfinite(times).sum()]
    kept = {_name(name): values[order] for name, values in columns.items()}
    return times[order] - times[order[0]], columns[speed][order], kept


def _name(text: str) -> str:
    return f"bench_{re.sub(r'[^0-9a-zA-Z]+', '_', text).strip('_').lower()}"


def aligned(path: Path, found: Mapping[tuple[str, str], Samples]) -> Bench:
    """Return the log of a bench in the time of the capture. Raises SetupError where no or several offsets fit."""
    times, speed, columns = read(path)
    results = []
    for one in found.values():
        pair = one.speed()
        if pair and one.times[-1] - one.times[0] > LEAST_SECONDS:
            own = np.abs(one.columns[pair[0]])
            good, theirs = np.isfinite(own), np.isfinite(speed)
            first = _grid(one.times[good], own[good]), _grid(times[theirs], np.abs(speed[theirs]))
            for fit, offset in _fits(*first):
                results.append((fit, one.times[good][0] + offset - times[theirs][0], one))
    results.sort(key=lambda each: -each[0])
    if not results or results[0][0] < LEAST:
        best = f"; the best correlation is {results[0][0]:.2f}" if results else ""
        raise SetupError(
            f"{path}: its speed fits no controller of the capture{best}, {LEAST} is needed: is it of this run?"
        )
    fit, offset, one = results[0]
    for other, where, who in results[1:]:
        if other > SECOND * fit and (who is not one or abs(where - offset) > APART):
            where_ = f"{where:.2f} s" + (f" on {who.controller}" if who is not one else "")
            raise SetupError(
                f"{path}: ambiguous, offsets of {offset:.2f} s on {one.controller} and {where_} fit alike ({fit:.3f}, "
                f"{other:.3f}): log a step of the speed that comes once, or cut the log"
            )
    rate, offset = _clock(one, times, speed, offset)
    said = f"{path.name} begins {offset:+.3f} s from the first message, its clock runs {rate * 1e6:+.0f} ppm"
    said += f" (correlation {fit:.3f} with the speed of {one.controller})"
    return Bench(one.controller, times * (1 + rate) + offset, columns, said)


def _grid(times: Array, values: Array) -> Array:
    return np.asarray(np.interp(np.arange(times[0], times[-1], STEP), times, values))


def _fits(own: Array, theirs: Array) -> list[tuple[float, float]]:
    """Return (correlation, offset in seconds) of the best offset, and of the best one further than APART from it.

    Half of the shorter one has to overlap. Sums over all offsets at once come of Fourier transforms.
    """
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
        if fit[at] <= 0:
            break
        found.append((float(min(fit[at], 1.0)), (at - (len(theirs) - 1)) * STEP))
        fit[max(0, at - int(APART / STEP)) : at + int(APART / STEP) + 1] = -1
    return found


def _clock(one: Samples, times: Array, speed: Array, offset: float) -> tuple[float, float]:
    """Return how much faster the capture's clock runs, and the offset, from the best offsets of parts of the log."""
    pair = one.speed()
    assert pair
    own = np.abs(one.columns[pair[0]])
    good = np.isfinite(own)
    own_times, own = one.times[good], own[good]
    whole, length = times[-1], max(10.0, times[-1] / 12)
    middles, offsets = [], []
    tries = np.arange(-1.0, 1.001, 0.01)
    for begin in np.arange(0, whole - length / 2, length):
        part = (times >= begin) & (times < begin + length) & np.isfinite(speed)
        inside = part & (times + offset > own_times[0]) & (times + offset < own_times[-1])
        if inside.sum() < 20 or np.std(speed[inside]) < 0.02 * np.nanmax(np.abs(speed)):
            continue
        theirs = np.abs(speed[inside])
        scale = np.interp(times[inside] + offset, own_times, own).sum() / max(theirs.sum(), 1e-9)
        sums = [
            ((np.interp(times[inside] + offset + each, own_times, own) - scale * theirs) ** 2).sum() for each in tries
        ]
        middles.append(begin + length / 2)
        offsets.append(offset + tries[int(np.argmin(sums))])
    if len(middles) < 4:
        return 0.0, float(np.median(offsets)) if offsets else offset
    x, y = np.array(middles), np.array(offsets)
    rate = slope(x, y)[0]
    return rate, float(np.median(y - rate * x))
