# SPDX-License-Identifier: GPL-2.0-or-later
"""How a measured value follows its command: a delay, then a response of first order, at 100 steps a second."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .series import APART, Array, Samples

STEP = 0.01  # seconds
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
        if len(told) < 50 or float(np.std(told)) < 1e-9:
            return None
        # Where nothing changes, nothing follows.
        moved = np.abs(np.diff(told, prepend=told[:1])) > 0.01 * np.std(told)
        changes = when[moved]
        behind = np.searchsorted(changes, own.times, side="right") - 1
        use = np.isfinite(own.columns[pair[0]]) & (behind >= 0)
        use &= own.times - (changes[np.maximum(behind, 0)] if len(changes) else -np.inf) < 1.5
        if use.sum() < 50:
            return None
        times = own.times[use]
        flights = []
        for number in np.unique(times // APART):
            its = when // APART == number
            flights.append(_predicted(when[its], told[its], is_sent))
        return cls(times, own.columns[pair[0]][use], flights, np.unique(times // APART, return_inverse=True)[1])

    def squares(self, shape: int, lag: float) -> Array:
        """Return the squared distance from what is predicted with this delay, (n)."""
        found = np.empty(len(self.times))
        for number, (begin, values) in enumerate(self.flights):
            its = self.number == number
            at = (self.times[its] - lag - begin) / STEP
            found[its] = np.interp(at, np.arange(values.shape[1]), values[shape])
        return np.asarray((self.measured - found) ** 2)

    def least(self, shape: int, lags: Array) -> float:
        """Return the least sum of squares of some delays."""
        return float(min(self.squares(shape, lag).sum() for lag in lags))


def command_of(samples: Mapping[tuple[str, str], Samples], own: Samples) -> tuple[Array, Array]:
    """Return times and values of a controller's command.

    That of the message that commands it, of the same name or bus, where the controller says that it has it; else what
    the controller says itself, ten times a second.
    """
    pair = own.speed()
    assert pair
    told = own.columns[pair[1]]
    for (who, message), one in samples.items():
        is_its = who == own.controller or bool({bus for bus, _ in one.ids} & {bus for bus, _ in own.ids})
        name = pair[1].removesuffix("_commanded")
        if message == own.message or name not in one.columns or not is_its or len(one.times) < 2:
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
    kept = np.exp(-STEP / np.maximum(SHAPES, 1e-6))
    values = np.empty((len(grid), len(SHAPES)))
    state = np.full(len(SHAPES), command[0])
    for at, value in enumerate(command):
        state = value + (state - value) * kept
        values[at] = state
    return float(grid[0]), np.ascontiguousarray(values.T)
