# SPDX-License-Identifier: GPL-2.0-or-later
"""MF4 and MCAP keep each source by itself: a signal of four controllers in one channel would be a zigzag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pyarrow as pa
import pyarrow.compute as pc

from .tables import Rows, Table
from .undecoded import source_name

KEY = ("bus", "id", "source")


def by_source(table: Table) -> Iterator[tuple[tuple[str, ...], pa.RecordBatch]]:
    """Return each batch's rows of one source, and what it is called: its name, or its bus and ID ("can0", "0x210").

    Events, faults, the summary and the flight stay together, and are called nothing.
    """
    for batch in table:
        if not isinstance(table, Rows):
            yield (), batch
            continue
        found = pa.Table.from_batches([batch]).group_by(list(KEY)).aggregate([]).to_pylist()
        for source in sorted(found, key=source_name):
            yield (
                (source["source"],) if source["source"] else tuple(source_name(source).split()),
                batch.filter(_is(batch, source)),
            )


def begin(tables: Sequence[Table]) -> int:
    """Return the time of the first message, in nanoseconds since 1970."""
    return min(table.first_time() for table in tables if isinstance(table, Rows))


def times_of(batch: pa.RecordBatch, start: int) -> pa.Array:
    """Return the times of rows in nanoseconds since 1970; start where there is none."""
    if "time" not in batch.schema.names:
        return pa.array([start] * len(batch), pa.int64())
    return pc.fill_null(batch.column("time").cast(pa.int64()), start)


def _is(batch: pa.RecordBatch, source: dict[str, str | int | None]) -> pa.Array:
    mask = pc.equal(batch.column("id"), source["id"])
    for key in ("bus", "source"):
        column, value = batch.column(key), source[key]
        mask = pc.and_(mask, pc.is_null(column) if value is None else pc.equal(column, value))
    return pc.fill_null(mask, False)
