# SPDX-License-Identifier: GPL-2.0-or-later
"""The load at which each sample was taken: what the values of a controller depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .series import APART, Array, Samples

MEMORY = (10.0, 40.0, 160.0)  # seconds for which a temperature remembers the load
RUNNING = 0.1  # of the usual highest speed: below, a motor stands


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
        # What a current takes from its supply at once is no cause of it: the slow part of the supply is.
        volts = _slow(lead.times, lead.columns[supply[0]]) if supply else np.zeros(len(speed))
        heat = _memory(lead.times, np.nan_to_num(speed) ** 2)
        return cls(lead.times, speed, volts, heat)

    def at(self, times: Array) -> Load:
        """Return the load at other times: that of the latest sample, NaN five seconds behind it."""
        at = np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)
        gone = np.abs(times - self.times[at]) > 5
        return Load(
            times, np.where(gone, np.nan, self.speed[at]), np.where(gone, np.nan, self.volts[at]), self.heat[at]
        )


def _slow(times: Array, values: Array, length: float = 20.0) -> Array:
    """Return the mean of the latest seconds, which begins anew with each flight."""
    found, state = np.empty(len(values)), np.nan
    kept = np.exp(-np.diff(times, prepend=times[:1] - APART) / length)
    for at, value in enumerate(values):
        if not np.isnan(value):
            state = value if np.isnan(state) else value + (state - value) * kept[at]
        found[at] = state
    return found


def _memory(times: Array, power: Array) -> Array:
    """Return the mean of the latest seconds, the older the less, for each length of MEMORY; (n, len(MEMORY))."""
    found = np.zeros((len(times), len(MEMORY)))
    gaps = np.diff(times, prepend=times[:1])
    for column, length in enumerate(MEMORY):
        state = 0.0
        kept = np.exp(-np.clip(gaps, 0, APART) / length)
        for at, value in enumerate(power):
            state = state * kept[at] + value * (1 - kept[at])
            found[at, column] = state
    return found


def terms(before: Load, after: Load, has_heat: bool) -> tuple[Array, Array]:
    """Return what a value depends on: (n, k) for the samples of both, and which of them are at a load of both, (n).

    Speed to the third power; of a temperature what the load was before, too. The supply only sorts into bins: what it
    does within 5 % is less than what a curve through it would make of noise.
    """
    speed, volts = (np.concatenate([getattr(one, name) for one in (before, after)]) for name in ("speed", "volts"))
    is_after = np.repeat([False, True], [len(before.times), len(after.times)])
    bins = load_bins(speed, volts)
    counts = [np.bincount(bins[own & (bins >= 0)], minlength=bins.max(initial=0) + 1) for own in (~is_after, is_after)]
    common = np.append((counts[0] >= 5) & (counts[1] >= 5), [False])
    top = max(float(np.nanmax(speed, initial=1.0)), 1.0)
    x = speed / top
    columns = [x, x**2, x**3]
    if has_heat:
        heat = np.concatenate([before.heat, after.heat]) / top**2
        columns += list(heat.T)
    return np.stack(columns, axis=1), common[bins]


def load_bins(speed: Array, volts: Array, count: int = 12, width: float = 0.05) -> Array:
    """Return the number of each sample's bin, of speed and voltage; -1 where the motor stands or nothing is known."""
    if not np.isfinite(speed).any():
        return np.full(len(speed), -1)
    top = max(float(np.nanquantile(speed, 0.98)), 1e-9)
    step = max(abs(float(np.nanmedian(volts))) * width, 1e-9)
    good = np.isfinite(speed) & np.isfinite(volts) & (speed > RUNNING * top)
    rows = np.clip(np.nan_to_num(speed) / top * count, 0, count + 3).astype(int)
    columns = np.nan_to_num(volts / step)
    columns = np.clip(np.round(columns - np.nanmedian(columns)) + 8, 0, 15).astype(int)
    return np.where(good, rows * 16 + columns, -1)
