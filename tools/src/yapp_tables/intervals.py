# SPDX-License-Identifier: GPL-2.0-or-later
"""Changes with intervals, for samples that are not independent: docs/compare.md explains each step.

Values 0.1 s apart say nearly the same. So samples are taken together in blocks of some seconds, which are taken to be
independent: what differs between blocks, not between samples, is the error of a mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
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
        reach = quantile(1 - chance, self.freedom) * self.error
        return self.value - reach, self.value + reach

    def less(self, value: float) -> Change:
        """Return the change beyond that of others."""
        return Change(self.value - value, self.error, self.freedom)


def quantile(share: float, freedom: float) -> float:
    """Return the quantile of Student's t (Cornish and Fisher's series, good from 8 degrees of freedom on)."""
    z = NormalDist().inv_cdf(share)
    first, second = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
    third = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return z + first / freedom + second / freedom**2 + third / freedom**3


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
        if least < 2 * LEAST_BLOCKS or _alike(means) < ALIKE:
            break
        length *= 1.5
    scores = np.stack([np.bincount(block, rest * column) for column in design.T], axis=1)
    blocks = len(count)
    spread = inverse @ (scores.T @ scores) @ inverse * blocks / (blocks - 1)
    return Change(float(weights[1]), math.sqrt(max(spread[1, 1], 0.0)), 2 * least - 2)


def _alike(means: Array) -> float:
    """Return the correlation of neighbours."""
    own = means - means.mean()
    return float((own[1:] * own[:-1]).sum() / max((own * own).sum(), 1e-300))


def more_often(before: int, after: int, share: float, clumps: float) -> float:
    """Return how likely as many events AFTER are, or more, if nothing changed.

    share: of the time that is AFTER's; clumps: how many come together (variance of blocks' counts over their mean).
    Of n events each is AFTER by this share: the tail of a binomial distribution.
    """
    few, many = round(before / clumps), round(after / clumps)
    k = np.arange(many, few + many + 1)
    ways = np.array([math.log(math.comb(few + many, int(each))) for each in k])
    return float(np.exp(ways + k * math.log(share) + (few + many - k) * math.log(1 - share)).sum())


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
