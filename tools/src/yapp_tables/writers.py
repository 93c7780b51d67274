# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight-1a2b3c4d.parquet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from .tables import Table

ROW_GROUP = 100_000


@dataclass(frozen=True)
class Target:
    """Where a writer writes. folder: for its files; name: of the files; url: of the whole data set."""

    folder: Path
    name: str
    url: str
    flight_id: str


Writer = Callable[[Sequence[Table], Target], None]


def write_parquet(tables: Sequence[Table], target: Target) -> None:
    """Write Parquet with row groups of at most ROW_GROUP rows, so that memory does not grow with the capture."""
    for table in tables:
        with pa.parquet.ParquetWriter(_path(target, table, "parquet"), table.schema, compression="zstd") as file:
            for group in _row_groups(table):
                file.write_table(group, ROW_GROUP)


def write_csv(tables: Sequence[Table], target: Target) -> None:
    """Write CSV with one header row; time as UTC with nine digits; absent values and reserved counts are empty."""
    for table in tables:
        with pa.csv.CSVWriter(_path(target, table, "csv"), table.schema) as file:
            for batch in table:
                file.write_batch(_finite(batch))


def _finite(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Return it without NaN and infinities: many a reader would take the whole column for text."""
    floating = (pa.types.is_floating(field.type) for field in batch.schema)
    columns = [pc.if_else(pc.is_finite(c), c, None) if f else c for c, f in zip(batch.columns, floating, strict=True)]
    return pa.RecordBatch.from_arrays(columns, schema=batch.schema)


def _path(target: Target, table: Table, suffix: str) -> Path:
    path = target.folder / f"message={table.name}" / f"{target.name}.{suffix}"
    path.parent.mkdir(parents=True)
    return path


def _row_groups(table: Table) -> Iterator[pa.Table]:
    held: list[pa.RecordBatch] = []
    for batch in table:
        held.append(batch)
        if sum(map(len, held)) >= ROW_GROUP:
            yield pa.Table.from_batches(held)
            held = []
    if held:
        yield pa.Table.from_batches(held)
