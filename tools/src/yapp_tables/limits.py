# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits of values, out of a file of rules for -z yapp,check or a default set, and what they say of a flight."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SetupError
from .series import Array, Source
from .tables import Column

Record = dict[str, Any]
RANGE = re.compile(r"(\w+)\.(\w+)(?:\.value)?=(-?[\d.]*?)\.\.(-?[\d.]*)")
# Ours, not the vendor's: what electronics and windings usually bear.
DEFAULTS = (
    "motor.motor_temperature=..120", "motor.esc_temperature=..100", "health.cpu_temperature=..105",
    "health.capacitor_temperature=..105", "health.fet_temperature=..120",
)  # fmt: skip


class Limits:
    """The rules that are ranges, `motor.dc_voltage=40..55`; of a source where they stand below `source=NAME`."""

    def __init__(self, path: Path | None = None) -> None:
        """path: a file of rules, None for the default set. Raises SetupError."""
        self.is_default, self.name = path is None, path.name if path else ""
        self.ranges: dict[tuple[str, str, str], tuple[float, float]] = {}
        source = ""
        for line in _lines(path) if path else DEFAULTS:
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


def _lines(path: Path) -> Sequence[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text"
        raise SetupError(f"the rules in {path} cannot be read: {reason}") from error


def minutes_left(source: Source, values: Array, high: float) -> float | None:
    """Return how long it takes to a limit; None where it moves away from it, or will stay below.

    The rise of the last minute is compared with that of the minute before: what slows down goes on to slow down.
    """
    good = np.isfinite(values)
    if not good.any():
        return None
    times, known = (source.times[good] - source.times[good][-1]) / 60, values[good]
    rates = []
    for begin in (-2.0, -1.0):
        use = (times > begin) & (times <= begin + 1)
        if not np.isfinite(high) or use.sum() < 3 or np.ptp(times[use]) < 0.5:
            return None
        rates.append(np.polyfit(times[use], known[use], 1)[0])
    before, rate = rates
    need = high - float(np.median(known[times > -0.1]))
    if rate < 1 or need <= 0:
        return None
    share = rate / before if before > rate else 1.0
    if share > 0.97:
        return float(need / rate)
    slowed = 1 - need * (1 - share) / (rate * share)
    return float(np.log(slowed) / np.log(share)) if slowed > 0 else None


def beyond(source: Source, values: Array, limits: tuple[float, float], column: Column, flying: Array) -> list[Record]:
    """Say when a value was outside its limits first and last, how far at most, and for how long.

    flying: which samples are of the flight: only in flight it goes on to rise.
    """
    found = []
    about = {"source": source.name, "field": column.name, "title": column.title, "unit": column.unit}
    for is_high, limit in ((False, limits[0]), (True, limits[1])):
        out = values > limit if is_high else values < limit
        if out.any():
            value = float(np.nanmax(values) if is_high else np.nanmin(values))
            times = source.times[out]
            word = "above" if is_high else "below"
            span = {"at": float(times[0]), "end": float(times[-1] + source.every), "word": word}
            found.append(about | span | {"kind": "limit", "value": value, "limit": limit,
                                         "seconds": float(out.sum() * source.every)})  # fmt: skip
    rising = np.where(flying, values, np.nan)
    left = minutes_left(source, rising, limits[1])
    if left is not None and left < 10 and not found:
        last = np.flatnonzero(np.isfinite(rising))[-1]
        at, now = float(source.times[last]), float(values[last])
        found.append(about | {"kind": "left", "at": at - 60, "end": at, "limit": limits[1], "value": now,
                              "seconds": left * 60})  # fmt: skip
    return found
