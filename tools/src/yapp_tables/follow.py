# SPDX-License-Identifier: GPL-2.0-or-later
"""How a measured value follows its command: a delay, then a response of first order, at 100 steps a second."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .intervals import BLOCK
from .load import smoothed
from .series import APART, Array, Samples

STEP = 0.01  # seconds
LAGS = np.arange(-0.2, 1.2, 0.02)  # seconds of the delay
# Seconds of the response's time constant.
SHAPES = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.17, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0)


@dataclass
class Following:
    """Samples of a value around changes of its command.

    times, measured: (n); flights: for each the begin of its grid and the value that each of SHAPES predicts,
    (len(SHAPES), m); number: (n) of the flight in that list.
    """

    times: Array
    measured: Array
    flights: list[tuple[float, Array]]
    number: Array

    @classmethod
    def of(cls, samples: Mapping[tuple[str, str], Samples], own: Samples) -> Following | None:
        """Return how a controller's value follows; None where its command hardly changes."""
        pair = own.speed()
        if pair is None:
            return None
        when, told = command_of(samples, own)
        is_sent, good = when is not own.times, np.isfinite(told)
        when, told = when[good], told[good]
        if not len(told):
            return None
        # Where nothing changes, nothing follows.
        changes = when[np.abs(np.diff(told, prepend=told[:1])) > max(0.01 * np.std(told), 1e-9)]
        behind = np.searchsorted(changes, own.times, side="right") - 1
        since = own.times - np.append(changes, np.inf)[behind]
        use = np.isfinite(own.columns[pair[0]]) & (behind >= 0) & (since < 1.5)
        if use.sum() < 50:
            return None
        numbers, number = np.unique(own.times[use] // APART, return_inverse=True)
        flights = [_predicted(when[when // APART == each], told[when // APART == each], is_sent) for each in numbers]
        return cls(own.times[use], own.columns[pair[0]][use], flights, number)

    def squares(self, shape: int, lag: float) -> Array:
        """Return the squared distance from what is predicted with this delay, (n)."""
        found = np.empty(len(self.times))
        for number, (begin, values) in enumerate(self.flights):
            its = self.number == number
            at = (self.times[its] - lag - begin) / STEP
            found[its] = np.interp(at, np.arange(values.shape[1]), values[shape])
        return np.asarray((self.measured - found) ** 2)


def responses(runs: Sequence[Following]) -> list[tuple[float, float, int]]:
    """Return of each run how many seconds a value is behind its command, the error of that, and the number of blocks.

    All runs have one shape of the response, each has its own delay: those of the least squares. The error is that of
    the jackknife: each block is left out once.
    """
    sums = [
        sum(min(run.squares(shape, lag).sum() for lag in LAGS[::3]) for run in runs) for shape in range(len(SHAPES))
    ]
    shape, found = int(np.argmin(sums)), []
    for run in runs:
        block = np.unique(np.floor(run.times / (2 * BLOCK)), return_inverse=True)[1]
        curves = np.stack([np.bincount(block, run.squares(shape, lag)) for lag in LAGS], axis=1)
        whole, count = curves.sum(axis=0), len(curves)
        without = np.array([_lowest(whole - curve) for curve in curves])
        error = float(np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum()))
        found.append((SHAPES[shape] + _lowest(whole), error, count))
    return found


def _lowest(curve: Array) -> float:
    """Return the delay where a curve is lowest: the vertex of the parabola through that point and its neighbours."""
    at = int(np.clip(np.argmin(curve), 1, len(curve) - 2))
    left, middle, right = curve[at - 1 : at + 2]
    bend = left - 2 * middle + right
    return float(LAGS[at] + (LAGS[1] - LAGS[0]) * (0.5 * (left - right) / bend if bend > 0 else 0.0))


def command_of(samples: Mapping[tuple[str, str], Samples], own: Samples) -> tuple[Array, Array]:
    """Return times and values of a controller's command.

    That of the message that commands it, of the same name or bus, where the controller says that it has it; else what
    the controller says itself, ten times a second.
    """
    pair = own.speed()
    assert pair
    told, name = own.columns[pair[1]], pair[1].removesuffix("_commanded")
    buses = {bus for bus, _ in own.ids}
    for one in samples.values():
        is_its = one.controller == own.controller or not buses.isdisjoint(bus for bus, _ in one.ids)
        if one.message == own.message or name not in one.columns or not is_its or len(one.times) < 2:
            continue
        values = one.columns[name]
        latest = values[np.maximum(np.searchsorted(one.times, own.times) - 1, 0)]
        good = np.isfinite(latest) & np.isfinite(told)
        if good.sum() > 50 and np.ptp(latest[good]) > 0:
            # Its unit may be another one: the controller's own is taken.
            scale, offset = np.polyfit(latest[good], told[good], 1)
            if abs(scale - 1) < 1e-3:
                scale, offset = 1.0, 0.0
            if np.std(told[good] - scale * latest[good]) < 0.25 * np.std(told[good]):
                return one.times, scale * values + offset
    return own.times, told


def _predicted(when: Array, told: Array, is_sent: bool) -> tuple[float, Array]:
    """Return the begin of a grid and the responses of all SHAPES to a command.

    is_sent: a command is in force from its message on; what a controller says ten times a second moves in between.
    """
    grid = np.arange(when[0], when[-1] + 2, STEP)
    if is_sent or float((np.diff(told) == 0).mean()) > 0.5:
        command = told[np.maximum(np.searchsorted(when, grid, side="right") - 1, 0)]
    else:
        command = np.interp(grid, when, told)
    return float(grid[0]), np.ascontiguousarray(smoothed(grid, command, *SHAPES).T)
