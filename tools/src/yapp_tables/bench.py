# SPDX-License-Identifier: GPL-2.0-or-later
"""The log of a thrust stand beside a capture: aligned by what both know, the speed."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from .errors import SetupError
from .runs import Samples
from .series import Array

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
        with path.open(encoding="utf-8-sig", newline="") as file:
            sample = file.read(4096)
            file.seek(0)
            rows = list(csv.reader(file, delimiter=";" if sample.count(";") > sample.count(",") else ","))
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"{path} cannot be read: {error}") from error
    if len(rows) < 20:
        raise SetupError(f"{path} has {len(rows)} rows; a log of a bench has a header and a row for each sample")
    head = rows[0]
    time = next(
        (at for at, name in enumerate(head) if re.match(r"\s*(time|t|timestamp)\b|.*_time\b", name, re.I)), None
    )
    speed = next((at for at, name in enumerate(head) if re.search(r"rpm|speed|drehzahl", name, re.I)), None)
    if time is None or speed is None:
        what = "time" if time is None else "speed (rpm)"
        raise SetupError(f"{path} has no column of {what}; its columns: {', '.join(head)}")
    body = [row for row in rows[1:] if len(row) == len(head)]
    columns = {name: np.array([_number(row[at]) for row in body]) for at, name in enumerate(head)}
    times = np.array([_seconds(row[time]) for row in body])
    if re.search(r"\bms\b|milli", head[time], re.I):
        times = times / 1e3
    elif re.search(r"\b[uµ]s\b|micro", head[time], re.I):
        times = times / 1e6
    good = np.isfinite(times)
    if good.sum() < 20:
        raise SetupError(f"{path}: {head[time]} is no time: {body[0][time]!r}; seconds, ms, or ISO 8601 are")
    order = np.flatnonzero(good)[np.argsort(times[good], kind="stable")]
    kept = {_name(name): values[order] for name, values in columns.items() if np.isfinite(values).mean() > 0.5
            and name != head[time]}  # fmt: skip
    return times[order] - times[order[0]], columns[head[speed]][order], kept


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _seconds(text: str) -> float:
    number = _number(text)
    if number == number:
        return number
    try:
        return datetime.fromisoformat(text.strip()).timestamp()
    except ValueError:
        return float("nan")


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
        return (
            np.concatenate([found[-(len(theirs) - 1) :], found[: len(own)]]) if len(theirs) > 1 else found[: len(own)]
        )

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
    if len(middles) < 2:
        return 0.0, offsets[0] if offsets else offset
    if len(middles) < 4:
        return 0.0, float(np.median(offsets))
    first, second = np.triu_indices(len(middles), 1)
    x, y = np.array(middles), np.array(offsets)
    rate = float(np.median((y[second] - y[first]) / (x[second] - x[first])))
    return rate, float(np.median(y - rate * x))
