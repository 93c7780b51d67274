# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits of values, out of a file of rules for -z yapp,check, and what they say of a flight."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SetupError
from .series import Array, Source
from .tables import Column

Record = dict[str, Any]
RANGE = re.compile(r"(\w+)\.(\w+)(?:\.value)?=(-?[\d.]*?)\.\.(-?[\d.]*)")
RATE = 60.0  # seconds: how fast a value moves is taken over so long
AMBER = 0.1  # of the way from a typical value to a limit


class Limits:
    """The rules that are ranges, `motor.dc_voltage=40..55`; of a source where they stand below `source=NAME`."""

    def __init__(self, path: Path | None = None) -> None:
        """path: a file of rules, None for no limits. Raises SetupError."""
        self.ranges: dict[tuple[str, str, str], tuple[float, float]] = {}
        source = ""
        for line in _lines(path) if path else ():
            text = line.partition("#")[0].strip()
            if text.startswith("source="):
                source = text.removeprefix("source=")
            elif found := RANGE.fullmatch(text):
                message, field, low, high = found.groups()
                self.ranges[source, message, field] = float(low or "-inf"), float(high or "inf")

    def of(self, source: str, message: str, field: str) -> tuple[float, float]:
        """Return the lowest and the highest value that a source may have; infinite where no rule says so."""
        general = self.ranges.get(("", message, field), (-np.inf, np.inf))
        own = self.ranges.get((source, message, field), general)
        return max(own[0], general[0]), min(own[1], general[1])


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text"
        raise SetupError(f"the rules in {path} cannot be read: {reason}") from error


def minutes_left(source: Source, values: Array, high: float) -> float | None:
    """Return how long it takes to a limit at the latest rate; None where it moves away from it or not at all."""
    good = np.isfinite(values) & (source.times > source.times[-1] - RATE)
    times, latest = source.times[good], values[good]
    if len(times) < 3 or not np.isfinite(high) or times[-1] - times[0] < RATE / 2:
        return None
    slope, now = np.polyfit(times - times[-1], latest, 1)
    return float((high - now) / slope / 60) if slope * RATE > 1 and now < high else None


def beyond(source: Source, values: Array, limits: tuple[float, float], column: Column) -> list[Record]:
    """Say when a value was outside its limits first, how far at most, and for how long."""
    found = []
    for is_high, limit in ((False, limits[0]), (True, limits[1])):
        out = values > limit if is_high else values < limit
        if not out.any():
            continue
        extreme = np.nanmax(values) if is_high else np.nanmin(values)
        word = "above" if is_high else "below"
        unit = f" {column.unit}" if column.unit else ""
        length = float(out.sum() * source.every)
        text = f"{column.title} {extreme:.4g}{unit}, {word} its limit of {limit:g}{unit} for {length:.3g} s"
        found.append({"source": source.name, "text": text, "at": float(source.times[out][0])})
    left = minutes_left(source, values, limits[1])
    if left is not None and left < 10 and not found:
        most = f"{limits[1]:g} {column.unit}"
        text = f"{column.title} reaches its limit of {most} in {left:.2g} minutes at the latest rate"
        found.append({"source": source.name, "text": text, "at": float(source.times[-1]) - RATE})
    return found
