# SPDX-License-Identifier: GPL-2.0-or-later
"""The load at which each sample was taken: what the values of a controller depend on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .series import APART, DEGREES, Array, Samples

MEMORY = (10.0, 40.0, 160.0)  # seconds for which a temperature remembers the load
SLOW = 20.0  # seconds: what a current takes from its supply at once is no cause of it, the slow part of the supply is
RUNNING = 0.1  # of the usual highest speed: below, a motor stands
LEAST_SAMPLES = 5  # of a bin, of each run


@dataclass
class Load:
    """What the values of a controller depend on. times, speed, volts: (n); heat: (n, len(MEMORY))."""

    times: Array
    speed: Array
    volts: Array
    heat: Array

    @classmethod
    def of(cls, lead: Samples) -> Load | None:
        """Return the load of a controller, from the message that has its speed; None without one."""
        pair, supply = lead.speed(), lead.supply()
        if pair is None:
            return None
        speed = np.abs(lead.columns[pair[0]])
        volts = smoothed(lead.times, lead.columns[supply[0]], SLOW)[:, 0] if supply else np.zeros(len(speed))
        return cls(lead.times, speed, volts, smoothed(lead.times, np.nan_to_num(speed) ** 2, *MEMORY))

    @classmethod
    def joined(cls, loads: Sequence[Load]) -> Load:
        """Return several loads as one, one behind the other."""
        return cls(*(np.concatenate(each) for each in zip(*(vars(load).values() for load in loads), strict=True)))

    def at(self, times: Array) -> Load:
        """Return the load at other times: that of the latest sample, NaN five seconds behind it."""
        at = np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)
        gone = np.abs(times - self.times[at]) > 5
        speed, volts = (np.where(gone, np.nan, values[at]) for values in (self.speed, self.volts))
        return Load(times, speed, volts, self.heat[at])

    def curve(self, unit: float, has_heat: bool) -> Array:
        """Return what a value depends on, (n, k): speed to the third power; a temperature also on the load before.

        The supply only sorts into bins: what it does within 5 % is less than what a curve would make of noise.
        """
        x = self.speed / unit
        return np.column_stack([x, x**2, x**3, *(self.heat.T / unit**2 if has_heat else [])])

    def bins(self, count: int = 12, width: float = 0.05) -> Array:
        """Return the number of each sample's bin, of speed and voltage; -1 where the motor stands or nothing is known.

        A number is 16 times the bin of speed, plus that of voltage.
        """
        good = np.isfinite(self.speed) & np.isfinite(self.volts)
        if not good.any():
            return np.full(len(self.speed), -1)
        top, usual = float(np.nanquantile(self.speed, 0.98)), float(np.nanmedian(self.volts))
        rows = np.clip(np.nan_to_num(self.speed) / max(top, 1e-9) * count, 0, count + 3).astype(int)
        steps = np.nan_to_num((self.volts - usual) / max(abs(usual) * width, 1e-9))
        columns = np.clip(np.round(steps) + 8, 0, 15).astype(int)
        return np.where(good & (self.speed > RUNNING * top), rows * 16 + columns, -1)

    def common(self, is_after: Array) -> Array:
        """Return which samples are in a bin that both runs have, (n) bool."""
        bins = self.bins()
        size = bins.max(initial=0) + 1
        counts = [np.bincount(bins[own & (bins >= 0)], minlength=size) for own in (~is_after, is_after)]
        return np.append(np.minimum(*counts) >= LEAST_SAMPLES, False)[bins]


def smoothed(times: Array, values: Array, *lengths: float) -> Array:
    """Return the mean of the latest seconds, the older the less, for each length: (n, len(lengths)).

    It begins anew with each flight.
    """
    found = np.empty((len(times), len(lengths)))
    kept = np.exp(-np.diff(times, prepend=times[:1] - APART)[:, None] / np.maximum(lengths, 1e-6))
    state = np.full(len(lengths), next(iter(values[np.isfinite(values)]), np.nan))
    for at, value in enumerate(values):
        if value == value:
            state = value + (state - value) * kept[at]
        found[at] = state
    return found


def dependent(one: Samples) -> Iterator[tuple[str, str]]:
    """Yield the values that depend on the load, each with its unit: A, %, or °C.

    Speed is the load itself; power follows from current.
    """
    for name in one.names("value", "A", "%", *DEGREES):
        if name not in (one.speed() or ()) and not name.endswith(("_commanded", "_error")):
            yield name, "°C" if one.unit_of(name) in DEGREES else one.unit_of(name)
