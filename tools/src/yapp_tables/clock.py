# SPDX-License-Identifier: GPL-2.0-or-later
"""The clock of a capture: how long it lasted where the clock was set anew, and whether it tells the time at all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from .scalars import scalar

# A clock that goes back by more than a second, or on by more than a day, was set anew.
BACK, ON = 1_000_000_000, 86_400_000_000_000
# Earlier times count from the recorder's own start: nobody recorded before 2000.
YEAR_2000 = 946_684_800_000_000_000


@dataclass
class Stretch:
    """A stretch of one clock. first, last: frames; low, high: nanoseconds since 1970."""

    first: int
    last: int
    low: int
    high: int

    def goes_on(self, other: Stretch) -> bool:
        """Return whether another stretch, of later frames, is of the same clock."""
        return other.first <= self.last or -BACK <= other.low - self.high <= ON


@dataclass(frozen=True)
class Clock:
    """What a flight's times say. start: nanoseconds since 1970, None where no absolute time is known."""

    start: int | None
    length: int
    resets: int


class Stretches:
    """The stretches of the times of one table, batch by batch, in the order of frames."""

    def __init__(self) -> None:
        """Begin without rows."""
        self.found: list[Stretch] = []

    def add(self, times: pa.Array, frames: pa.Array) -> None:
        """Add a batch that is not empty."""
        counts = times.cast(pa.int64())
        steps = pc.pairwise_diff(counts)
        is_new = pc.or_(pc.less(steps, scalar(-BACK)), pc.greater(steps, scalar(ON)))
        starts = pc.indices_nonzero(is_new).to_pylist()
        for begin, end in zip([0, *starts], [*starts, len(counts)], strict=True):
            span = pc.min_max(counts[begin:end])
            stretch = Stretch(frames[begin].as_py(), frames[end - 1].as_py(), span["min"].as_py(), span["max"].as_py())
            self._join(stretch)

    def _join(self, stretch: Stretch) -> None:
        last = self.found[-1] if self.found else None
        if last is None or not -BACK <= stretch.low - last.high <= ON:
            self.found.append(stretch)
        else:
            last.last, last.high = stretch.last, max(last.high, stretch.high)


def clock_of(tables: Iterable[Stretches]) -> Clock:
    """Return what the times of all tables of a flight say together."""
    whole: list[Stretch] = []
    for each in sorted((each for table in tables for each in table.found), key=lambda each: each.first):
        last = whole[-1] if whole else None
        if last and last.goes_on(each):
            last.last, last.low, last.high = (
                max(last.last, each.last),
                min(last.low, each.low),
                max(last.high, each.high),
            )
        else:
            whole.append(Stretch(each.first, each.last, each.low, each.high))
    start, length = None, 0
    for each in whole:
        if start is None and each.low >= YEAR_2000:
            start = each.low - length
        length += each.high - each.low
    return Clock(start, length, max(len(whole) - 1, 0))
