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
LEAST_SECONDS, LEAST_ROWS = 5.0, 20
UNITS = {r"\bms\b|milli": 1e3, r"\b[uµ]s\b|micro": 1e6}  # of a second, in the name of the column of time


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
        mark = ";" if sample.count(b";") > sample.count(b",") else ","
        table = csv.read_csv(path, parse_options=csv.ParseOptions(delimiter=mark, invalid_row_handler=lambda _: "skip"))
    except (OSError, pa.ArrowInvalid) as error:
        raise SetupError(f"{path} cannot be read: {error}") from error
    names = table.schema.names
    columns = {each.name: numbers(table[each.name]) for each in table.schema
               if pa.types.is_integer(each.type) or pa.types.is_floating(each.type)}  # fmt: skip
    time = next((name for name in names if re.match(r"\s*(time|t|timestamp)\b|.*_time\b", name, re.I)), "")
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
    order = np.argsort(times, kind="stable")[: np.isfinite(times).sum()]
    plain = {name: re.sub(r"[^0-9a-zA-Z]+", "_", name).strip("_").lower() for name in columns}
    kept = {f"bench_{plain[name]}": values[order] for name, values in columns.items()}
    return times[order] - times[order[0]], columns[speed][order], kept


def aligned(path: Path, found: Mapping[tuple[str, str], Samples]) -> Bench:
    """Return the log of a bench in the time of the capture. Raises SetupError where no or several offsets fit."""
    times, speed, columns = read(path)
    there, results = np.isfinite(speed), []
    theirs = _grid(times[there], np.abs(speed[there]))
    for one in found.values():
        pair = one.speed()
        if pair and one.times[-1] - one.times[0] > LEAST_SECONDS:
            own = np.abs(one.columns[pair[0]])
            good = np.isfinite(own)
            for fit, offset in _fits(_grid(one.times[good], own[good]), theirs):
                offset += one.times[good][0] - times[there][0]
                results.append((fit, offset, one.controller, (one.times[good], own[good])))
    results.sort(key=lambda each: -each[0])
    if not results or results[0][0] < LEAST:
        best = f"; the best correlation is {results[0][0]:.2f}" if results else ""
        raise SetupError(
            f"{path}: its speed fits no controller of the capture{best}, {LEAST} is needed: is it of this run?"
        )
    fit, offset, who, own_line = results[0]
    for other, where, whose, _ in results[1:]:
        if other > SECOND * fit and (whose != who or abs(where - offset) > APART):
            raise SetupError(
                f"{path}: ambiguous, offsets of {offset:.2f} s on {who} and {where:.2f} s on {whose} fit alike "
                f"({fit:.3f}, {other:.3f}): log a step of the speed that comes once, or cut the log"
            )
    rate, offset = _clock(own_line, (times, np.abs(speed)), offset)
    said = f"{path.name} begins {offset:+.3f} s from the first message, its clock runs {rate * 1e6:+.0f} ppm"
    said += f" (correlation {fit:.3f} with the speed of {who})"
    return Bench(who, times * (1 + rate) + offset, columns, said)


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
        found.append((float(min(fit[at], 1.0)), (at - (len(theirs) - 1)) * STEP))
        fit[max(0, at - int(APART / STEP)) : at + int(APART / STEP) + 1] = -1
    return found


def _clock(own: tuple[Array, Array], log: tuple[Array, Array], offset: float) -> tuple[float, float]:
    """Return how much faster the capture's clock runs, and the offset, from the best offsets of parts of the log.

    own, log: times and speeds.
    """
    times, speed = log
    length, tries = max(10.0, times[-1] / 12), np.arange(-1.0, 1.001, 0.01)
    parts = []
    for begin in np.arange(0, times[-1] - length / 2, length):
        inside = (times >= begin) & (times < begin + length) & np.isfinite(speed)
        inside &= (times + offset > own[0][0]) & (times + offset < own[0][-1])
        if inside.sum() >= LEAST_ROWS and np.std(speed[inside]) > 0.02 * np.nanmax(speed):
            lines = np.stack([np.interp(times[inside] + offset + each, *own) for each in tries])
            scale = lines.sum() / len(tries) / max(speed[inside].sum(), 1e-9)
            sums = ((lines - scale * speed[inside]) ** 2).sum(axis=1)
            parts.append((begin + length / 2, offset + tries[int(np.argmin(sums))]))
    middles, offsets = np.array(parts or [(0.0, offset)]).T
    rate = slope(middles, offsets)[0] if len(parts) > 3 else 0.0
    return rate, float(np.median(offsets - rate * middles))
