# SPDX-License-Identifier: GPL-2.0-or-later
"""MF4 and MCAP keep each source by itself: a signal of four controllers in one channel would be a zigzag."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pyarrow as pa
import pyarrow.compute as pc

KEY = ("bus", "id", "source")


def by_source(batches: Iterable[pa.RecordBatch]) -> Iterator[tuple[tuple[str, ...], pa.RecordBatch]]:
    """Each batch's rows of one source, and what the source is called: its name, or its bus and ID ("can0", "0x210")."""
    for batch in batches:
        table = pa.Table.from_batches([batch])
        for source in sorted(table.group_by(list(KEY)).aggregate([]).to_pylist(), key=_names):
            yield _names(source), batch.filter(_is(batch, source))


def _is(batch: pa.RecordBatch, source: dict[str, str | int | None]) -> pa.Array:
    mask = pc.equal(batch.column("id"), source["id"])
    for key in ("bus", "source"):
        column, value = batch.column(key), source[key]
        mask = pc.and_(mask, pc.is_null(column) if value is None else pc.equal(column, value))
    return pc.fill_null(mask, False)


def _names(source: dict[str, str | int | None]) -> tuple[str, ...]:
    if source["source"]:
        return (str(source["source"]),)
    number = f"0x{source['id']:03x}"
    return (str(source["bus"]), number) if source["bus"] else (number,)
