# SPDX-License-Identifier: GPL-2.0-or-later
"""How long a controller takes to follow its Command: from a change to 63 % of it in the measured value."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import pyarrow as pa
import pyarrow.compute as pc

from .scalars import scalar

LAG = "command_lag"
# 1 - 1/e, as for the time constant of a filter.
SHARE = 0.632
# A change counts if it is this share of what the field covers in the flight: a ramp of small steps has no lag.
LEAST = 0.05


@dataclass(frozen=True)
class Step:
    """A change of a Command.

    time, until: nanoseconds, until the next one; who: bus and name of the Command's source; measured: the field that
    follows; threshold: 63 % of the change; sign: 1 where it rises, else -1.
    """

    time: int
    until: int
    who: tuple[str | None, str | None]
    measured: str
    threshold: float
    sign: int


def steps(commands: pa.Table, fields: Mapping[str, str]) -> list[Step]:
    """Return the changes in the rows of Command, in order of time. fields: {its field: the measured field}."""
    found = []
    for name, measured in fields.items():
        if name not in commands.schema.names:
            continue
        span = pc.min_max(commands[name])
        low, high = span["min"].as_py(), span["max"].as_py()
        if low is None or low == high:
            continue
        own: dict[tuple[str | None, str | None], list[tuple[int, float]]] = defaultdict(list)
        rows = [commands[each].to_pylist() for each in ("time", "bus", "source", name)]
        for time, bus, source, value in zip(*rows, strict=True):
            if value is not None:
                own[bus, source].append((time, value))
        for who, values in own.items():
            changes = [(time, before, value) for (_, before), (time, value) in pairwise(values) if value != before]
            ends = [time for time, *_ in changes[1:]] + [1 << 62]
            for (time, before, value), until in zip(changes, ends, strict=True):
                if abs(value - before) >= LEAST * (high - low):
                    threshold = before + SHARE * (value - before)
                    found.append(Step(time, until, who, measured, threshold, 1 if value > before else -1))
    return sorted(found, key=lambda step: step.time)


class Lags:
    """The lags of all sources of a message, batch by batch."""

    def __init__(self, found: Sequence[Step]) -> None:
        """found: the changes of the Command, in order of time."""
        self.waiting = list(found)
        self.done: set[tuple[Step, object]] = set()

    def measure(self, given: Mapping[str, pa.Array]) -> pa.Array:
        """Return a batch's lags, each in the row that reached 63 % first; null elsewhere."""
        times = given["time"].cast(pa.int64())
        span = pc.min_max(times)
        low, high = span["min"].as_py(), span["max"].as_py()
        self.waiting = [step for step in self.waiting if step.until > low]
        lags = array("q", [-1]) * len(times)
        for step in self.waiting:
            if step.time > high:
                break
            values = given[step.measured]
            has_reached = pc.greater_equal if step.sign > 0 else pc.less_equal
            is_now = pc.and_(pc.greater_equal(times, scalar(step.time)), pc.less(times, scalar(step.until)))
            is_there = pc.and_(is_now, has_reached(values, scalar(step.threshold)))
            for row in pc.indices_nonzero(is_there).to_pylist():
                bus, source, number = (given[name][row].as_py() for name in ("bus", "source", "id"))
                # A name ties both; without names, the Command of a bus is for all controllers on it.
                is_told = step.who[1] == source if source and step.who[1] else step.who[0] == bus
                key = (step, (bus, number))
                if is_told and key not in self.done:
                    self.done.add(key)
                    lags[row] = times[row].as_py() - step.time
        found = pa.Array.from_buffers(pa.int64(), len(lags), [None, pa.py_buffer(lags)])
        nothing = pa.nulls(len(lags), pa.int64())
        return pc.if_else(pc.less(found, scalar(0)), nothing, found).cast(pa.duration("ns"))
