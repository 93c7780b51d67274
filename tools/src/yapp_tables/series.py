# SPDX-License-Identifier: GPL-2.0-or-later
"""Numbers for pictures: samples thinned so that extremes and gaps stay, and spans in which something held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from .sources import split

# A gap is longer than this many periods, as for the plugin's yapp.late.
LATE = 2.5
Array = np.ndarray[Any, Any]


@dataclass
class Source:
    """The rows of one message of one source. times: seconds since the report's start; every: its period in seconds."""

    name: str
    rows: pa.Table
    times: Array
    every: float

    def gaps(self) -> Array:
        """The indices of the last samples before a gap."""
        return np.flatnonzero(np.diff(self.times) > LATE * self.every)


def sources(table: pa.Table, every: float | None, start: int) -> Iterator[Source]:
    """A message's rows by source: the user's name for it, or its bus and ID.  start: nanoseconds since 1970."""
    for name, own in split(table):
        rows = own.sort_by("time")
        times = (rows["time"].cast(pa.int64()).to_numpy() - start) / 1e9
        period = every or (float(np.median(np.diff(times))) if len(times) > 1 else 1.0)
        yield Source(name, rows, times, period)


def numbers(column: pa.ChunkedArray) -> Array:
    """A column as float64, durations in seconds; where there is no value it is NaN: nothing is drawn there."""
    if pa.types.is_duration(column.type):
        return numbers(column.cast(pa.int64())) / 1e9
    values = column.cast(pa.float64(), safe=False).to_numpy()
    return np.where(np.isfinite(values), values, np.nan)


def thin(source: Source, columns: list[Array], most: int) -> tuple[Array, list[Array]]:
    """At most about `most` samples, of several columns with the same times: of each stretch, its smallest and largest.

    Where the source was silent a sample without a value is put in, so that no line is drawn over the gap.
    """
    times, gaps = source.times, source.gaps()
    if len(times) > most:
        size = -(-2 * len(times) // most)
        starts = np.unique(np.concatenate([np.arange(0, len(times), size), gaps + 1]))
        columns = [_extremes(column, starts) for column in columns]
        ends = np.append(starts[1:], len(times)) - 1
        at = np.searchsorted(starts, gaps, side="right") * 2
        thinned = np.stack([times[starts], times[ends]], axis=1).ravel()
    else:
        thinned, at = times, gaps + 1
    return np.insert(thinned, at, times[gaps] + source.every), [np.insert(column, at, np.nan) for column in columns]


def with_gaps(source: Source, columns: list[Array]) -> tuple[Array, list[Array]]:
    """Return times and values with a sample without a value in each gap, so that no line is drawn over it."""
    return thin(source, columns, len(source.times) + 1)


def _extremes(values: Array, starts: Array) -> Array:
    """Two values for each stretch: the one of smallest and largest that comes first, then the other."""
    low = np.fmin.reduceat(values, starts)
    high = np.fmax.reduceat(values, starts)
    stretch = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(values))))
    places = np.arange(len(values))
    first_low = np.minimum.reduceat(np.where(values == low[stretch], places, len(values)), starts)
    first_high = np.minimum.reduceat(np.where(values == high[stretch], places, len(values)), starts)
    falls = first_high < first_low
    return np.stack([np.where(falls, high, low), np.where(falls, low, high)], axis=1).ravel()


def spans(source: Source, values: Array, most: int) -> list[tuple[float, float, Any]]:
    """(begin, end, value) of each stretch of equal values, cut at gaps; above `most` the shortest are left out."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    after_gap = source.gaps() + 1
    starts = np.unique(np.concatenate([[0], changes, after_gap]))
    ends = np.append(source.times[starts[1:]], source.times[-1] + source.every)
    cut = np.isin(np.append(starts[1:], -1), after_gap)
    last = np.append(starts[1:], len(values)) - 1
    ends = np.where(cut, source.times[last] + source.every, ends)
    begins = source.times[starts]
    kept = np.sort(np.argsort(begins - ends, kind="stable")[:most])
    return [(float(begins[i]), float(ends[i]), values[starts[i]]) for i in kept]
