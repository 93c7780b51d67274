# SPDX-License-Identifier: GPL-2.0-or-later
"""What flights are compared by: changes with intervals, load, response to a command; docs/compare.md explains it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from .series import APART, DEGREES, Array, Samples

BLOCK, LEAST_BLOCKS = 4.0, 8  # seconds of the shortest block; blocks of each side that are needed
ALIKE = 0.25  # blocks whose neighbours are more alike than this are made longer


@dataclass(frozen=True)
class Change:
    """A change from BEFORE to AFTER. error: its standard error; freedom: degrees of freedom."""

    value: float
    error: float
    freedom: float

    def within(self, chance: float = 0.025) -> tuple[float, float]:
        """Return the interval, beyond each end of which the true change lies by this chance: 0.025 for 95 %."""
        z = NormalDist().inv_cdf(1 - chance)
        # The quantile of Student's t: Cornish and Fisher's series, good from 8 degrees of freedom on.
        first, second = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
        third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
        reach = (z + first / self.freedom + second / self.freedom**2 + third / self.freedom**3) * self.error
        return self.value - reach, self.value + reach


def change(times: Array, values: Array, is_after: Array, load: Array | None = None) -> Change | None:
    """Return how much higher values are AFTER at equal load; None if there are too few blocks.

    times: (n) seconds, those of different flights far apart; values: (n); is_after: (n) bool; load: (n, k), what the
    values depend on besides. Least squares give the change; the spread of the blocks' residuals gives its error.
    """
    good = np.isfinite(values) if load is None else np.isfinite(values) & np.isfinite(load).all(axis=1)
    times, values, side = times[good], values[good], is_after[good].astype(float)
    if not 0 < side.sum() < len(side):
        return None
    columns = [np.ones(len(values)), side] if load is None else [np.ones(len(values)), side, *load[good].T]
    design = np.stack(columns, axis=1)
    inverse = np.linalg.pinv(design.T @ design, hermitian=True)
    weights = inverse @ (design.T @ values)
    rest = values - design @ weights
    duration = len(times) * float(np.median(np.diff(times)))
    length = float(np.clip(duration / 30, BLOCK, 3 * BLOCK))
    while True:
        _, block = np.unique(np.floor(times / length) * 2 + side, return_inverse=True)
        count = np.bincount(block)
        sides = np.bincount(block, side) / count
        least = min(int((sides > 0.5).sum()), int((sides < 0.5).sum()))
        if least < LEAST_BLOCKS:
            return None
        means = np.bincount(block, rest) / count
        means -= means.mean()
        alike = (means[1:] * means[:-1]).sum() / max((means * means).sum(), 1e-300)  # the correlation of neighbours
        if least < 2 * LEAST_BLOCKS or alike < ALIKE:
            break
        length *= 1.5
    scores = np.stack([np.bincount(block, rest * column) for column in design.T], axis=1)
    blocks = len(count)
    spread = inverse @ (scores.T @ scores) @ inverse * blocks / (blocks - 1)
    return Change(float(weights[1]), math.sqrt(max(spread[1, 1], 0.0)), 2 * least - 2)


def more_often(before: int, after: int, share: float) -> float:
    """Return how likely as many events AFTER are, or more, if nothing changed.

    share: of the time that is AFTER's. Of n events each is AFTER by this share: the tail of a binomial distribution.
    """
    k = np.arange(after, before + after + 1)
    ways = np.array([math.log(math.comb(before + after, int(each))) for each in k])
    return float(np.exp(ways + k * math.log(share) + (before + after - k) * math.log(1 - share)).sum())


def slope(x: Array, y: Array, chance: float = 0.025) -> tuple[float, float, float]:
    """Return Theil and Sen's slope, the median of the slopes of all pairs, and its interval.

    x: (n) without equal neighbours; a single outlier does not move it. The interval is Sen's, from Kendall's variance.
    """
    first, second = np.triu_indices(len(x), 1)
    apart = x[second] - x[first]
    slopes = np.sort((y[second] - y[first])[apart != 0] / apart[apart != 0])
    count = len(x)
    reach = NormalDist().inv_cdf(1 - chance) * math.sqrt(count * (count - 1) * (2 * count + 5) / 18)
    low = max(0, math.floor((len(slopes) - reach) / 2))
    high = min(len(slopes) - 1, math.ceil((len(slopes) + reach) / 2))
    return float(np.median(slopes)), float(slopes[low]), float(slopes[high])


# ---- the load at which each sample was taken

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
    def of(cls, lead: Samples) -> "Load | None":
        """Return the load of a controller, from the message that has its speed; None without one."""
        pair, supply = lead.speed(), lead.supply()
        if pair is None:
            return None
        speed = np.abs(lead.columns[pair[0]])
        volts = smoothed(lead.times, lead.columns[supply[0]], SLOW)[:, 0] if supply else np.zeros(len(speed))
        return cls(lead.times, speed, volts, smoothed(lead.times, np.nan_to_num(speed) ** 2, *MEMORY))

    def at(self, times: Array) -> "Load":
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

    def bins(self) -> Array:
        """Return each sample's bin, 16 * that of speed + that of voltage; -1: the motor stands, or nothing is known."""
        good = np.isfinite(self.speed) & np.isfinite(self.volts)
        if not good.any():
            return np.full(len(self.speed), -1)
        top, usual = float(np.nanquantile(self.speed, 0.98)), float(np.nanmedian(self.volts))
        rows = np.clip(np.nan_to_num(self.speed) / max(top, 1e-9) * 12, 0, 15).astype(int)
        steps = np.nan_to_num((self.volts - usual) / max(abs(usual) * 0.05, 1e-9))
        columns = np.clip(np.round(steps) + 8, 0, 15).astype(int)
        return np.where(good & (self.speed > RUNNING * top), rows * 16 + columns, -1)

    def common(self, is_after: Array) -> Array:
        """Return which samples are in a bin that both runs have, (n) bool."""
        bins = self.bins()
        size = bins.max(initial=0) + 1
        counts = [np.bincount(bins[own & (bins >= 0)], minlength=size) for own in (~is_after, is_after)]
        return np.append(np.minimum(*counts) >= LEAST_SAMPLES, False)[bins]


def smoothed(times: Array, values: Array, *lengths: float) -> Array:
    """Return the mean of each flight's latest seconds, the older the less, for each length: (n, len(lengths))."""
    found = np.empty((len(times), len(lengths)))
    kept = np.exp(-np.diff(times, prepend=times[:1] - APART)[:, None] / np.maximum(lengths, 1e-6))
    state = np.full(len(lengths), next(iter(values[np.isfinite(values)]), np.nan))
    for at, value in enumerate(values):
        if value == value:
            state = value + (state - value) * kept[at]
        found[at] = state
    return found


def dependent(one: Samples) -> Iterator[tuple[str, str]]:
    """Yield what depends on the load, with its unit, A, % or °C: speed is the load, power follows from current."""
    for name in one.names("value", "A", "%", *DEGREES) if one.names("clock") else ():
        if name not in (one.speed() or ()) and not name.endswith(("_commanded", "_error")):
            yield name, "°C" if one.unit_of(name) in DEGREES else one.unit_of(name)


def comparable(values: Array, good: Array, unit: str) -> tuple[Array, Array]:
    """Return values as they are compared, and which of them: a current as a multiple, by its logarithm.

    A current of both signs has no multiple: none of it is compared.
    """
    if unit != "A" or not good.any():
        return values, good
    good = good & (values > 0.1 * np.median(values[good])) & bool((values[good] > 0).mean() > 0.98)
    return np.log(np.where(good, values, 1.0)), good


# ---- a delay, then a response of first order, at 100 steps a second

STEP = 0.01  # seconds
LAG = 0.005  # seconds between two delays: over 0.02 the squares are no parabola
LAGS, COARSE = np.arange(-0.2, 1.2, LAG), 12  # of the delay; a step between those that are tried first
# Seconds of the response's time constant.
SHAPES = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.17, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0)


@dataclass
class Following:
    """Samples of a value around changes of its command.

    times, measured: (n); grid: (m) times; predicted: (len(SHAPES), m), the response of each of SHAPES to the command.
    """

    times: Array
    measured: Array
    grid: Array
    predicted: Array

    @classmethod
    def of(cls, samples: Mapping[tuple[str, str], Samples], own: Samples) -> "Following | None":
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
        flights = [when[when // APART == number] for number in np.unique(when // APART)]
        grid = np.concatenate([np.arange(its[0], its[-1] + 2, STEP) for its in flights])
        # A command is in force from its message on; what a controller says ten times a second moves in between.
        command = np.interp(grid, when, told)
        if is_sent or float((np.diff(told) == 0).mean()) > 0.5:
            command = told[np.maximum(np.searchsorted(when, grid, side="right") - 1, 0)]
        predicted = np.ascontiguousarray(smoothed(grid, command, *SHAPES).T)
        return cls(own.times[use], own.columns[pair[0]][use], grid, predicted)

    def squares(self, shape: int, lag: float) -> Array:
        """Return the squared distance from what is predicted with this delay, (n)."""
        return np.asarray((self.measured - np.interp(self.times - lag, self.grid, self.predicted[shape])) ** 2)

    def least(self, shape: int) -> float:
        """Return the sum of squares at the best delay: of some, then of all around the best of these."""
        near = COARSE * int(np.argmin([self.squares(shape, lag).sum() for lag in LAGS[::COARSE]]))
        around = LAGS[max(near - COARSE, 0) : near + COARSE + 1]
        return min(float(self.squares(shape, lag).sum()) for lag in around)


def responses(runs: Sequence[Following]) -> list[tuple[float, float, int]]:
    """Return of each run how many seconds a value is behind its command, the error of that, and the number of blocks.

    All runs have one shape of the response, each has its own delay: those of the least squares. The error is that of
    the jackknife: each block is left out once.
    """
    shape, found = int(np.argmin([sum(run.least(each) for run in runs) for each in range(len(SHAPES))])), []
    for run in runs:
        block = np.unique(np.floor(run.times / (2 * BLOCK)), return_inverse=True)[1]
        curves = np.stack([np.bincount(block, run.squares(shape, lag)) for lag in LAGS], axis=1)
        whole, count = curves.sum(axis=0), len(curves)
        without = LAG * np.array([lowest(whole - curve) for curve in curves])
        error = float(np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum()))
        found.append((SHAPES[shape] + LAGS[0] + LAG * lowest(whole), error, count))
    return found


def lowest(curve: Array) -> float:
    """Return the index at which a curve is lowest: the vertex of the parabola through that point and its neighbours."""
    at = int(np.clip(np.argmin(curve), 1, len(curve) - 2))
    left, middle, right = curve[at - 1 : at + 2]
    bend = left - 2 * middle + right
    return at + float(0.5 * (left - right) / bend if bend > 0 else 0.0)


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
        latest = one.columns[name][np.maximum(np.searchsorted(one.times, own.times) - 1, 0)]
        good = np.isfinite(latest) & np.isfinite(told)
        if good.sum() > 50 and np.std(told[good] - latest[good]) < 0.25 * np.std(told[good]):
            return one.times, one.columns[name]
    return own.times, told
