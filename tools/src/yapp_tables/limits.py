# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits of values, out of a file of rules for -z yapp,check or a default set, and what they say of a flight."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SetupError
from .series import Array, Samples

Record = dict[str, Any]
RANGE = re.compile(r"(\w+)\.(\w+)(?:\.value)?=(-?[\d.]*?)\.\.(-?[\d.]*)")
# Ours, not the vendor's: what electronics and windings usually bear.
DEFAULTS = """
motor.motor_temperature=..120
motor.esc_temperature=..100
health.cpu_temperature=..105
health.capacitor_temperature=..105
health.fet_temperature=..120
"""


class Limits:
    """The rules that are ranges, `motor.dc_voltage=40..55`; of a source where they stand below `source=NAME`."""

    def __init__(self, path: Path | None = None) -> None:
        """path: a file of rules, None for the default set. Raises SetupError."""
        self.is_default, self.name = path is None, path.name if path else ""
        self.ranges: dict[tuple[str, str, str], tuple[float, float]] = {}
        try:
            lines = (path.read_text(encoding="utf-8") if path else DEFAULTS).splitlines()
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is no text"
            raise SetupError(f"the rules in {path} cannot be read: {reason}") from error
        source = ""
        for text in (line.partition("#")[0].strip() for line in lines):
            if text.startswith("source="):
                source = text.removeprefix("source=")
            elif found := RANGE.fullmatch(text):
                message, field, low, high = found.groups()
                self.ranges[source, message, field] = float(low or "-inf"), float(high or "inf")

    def of(self, one: Samples, field: str) -> tuple[float, float]:
        """Return the lowest and the highest value that a source may have; infinite where no rule says so."""
        general = self.ranges.get(("", one.message, field), (-np.inf, np.inf))
        own = self.ranges.get((one.name, one.message, field), general)
        return max(own[0], general[0]), min(own[1], general[1])


def minutes_left(times: Array, values: Array, high: float) -> float | None:
    """Return how long it takes to a limit; None where it moves away from it, or will stay below.

    times: seconds; the rise of the last minute is compared with that of the minute before: what slows down goes on to
    slow down.
    """
    good = np.isfinite(values)
    if not good.any() or not np.isfinite(high):
        return None
    minutes, known = (times[good] - times[good][-1]) / 60, values[good]
    rates = []
    for begin in (-2.0, -1.0):
        use = (minutes > begin) & (minutes <= begin + 1)
        if use.sum() < 3 or np.ptp(minutes[use]) < 0.5:
            return None
        rates.append(float(np.polyfit(minutes[use], known[use], 1)[0]))
    before, rate = rates
    need = high - float(np.median(known[minutes > -0.1]))
    if rate < 1 or need <= 0:
        return None
    share = rate / before if before > rate else 1.0
    if share > 0.97:
        return need / rate
    slowed = 1 - need * (1 - share) / (rate * share)
    return float(np.log(slowed) / np.log(share)) if slowed > 0 else None


def beyond(one: Samples, name: str, limits: tuple[float, float]) -> list[Record]:
    """Say when a value was outside its limits first and last, how far at most, and for how long."""
    found, values = [], one.columns[name]
    for word, limit, sign in zip(("below", "above"), limits, (-1, 1), strict=True):
        out = sign * values > sign * limit
        if out.any():
            span = {"at": float(one.times[out][0]), "end": float(one.times[out][-1] + one.every)}
            how = {"kind": "limit", "limit": limit, "word": word, "seconds": float(out.sum() * one.every)}
            found.append(span | how | {"value": sign * float(np.nanmax(sign * values))})
    rising = np.where(one.flying, values, np.nan)  # only in flight it goes on to rise
    left = minutes_left(one.times, rising, limits[1])
    if left is not None and left < 10 and not found:
        last = np.flatnonzero(np.isfinite(rising))[-1]
        at, now = float(one.times[last]), float(values[last])
        found.append({"kind": "left", "at": at - 60, "end": at, "limit": limits[1], "value": now, "seconds": left * 60})
    about = {"source": one.name, "field": name, "title": one.title_of(name), "unit": one.unit_of(name)}
    return [about | row | {"is_supply": name in (one.supply() or ())} for row in found]
