# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight-1a2b3c4d.parquet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet
from pyarrow import csv as arrow_csv

from .tables import DURATION, KIND, Table

ROW_GROUP = 100_000
CSV_TYPES = {KIND: pa.string(), DURATION: pa.float64()}


@dataclass(frozen=True)
class Target:
    """Where a writer writes. folder: for its files; name: of the files; url: of the whole data set.

    partition: a folder below that of each table, "day=2023-11-14", empty for none.
    """

    folder: Path
    name: str
    url: str
    flight_id: str
    partition: str = ""


Writer = Callable[[Sequence[Table], Target], None]


def write_parquet(tables: Sequence[Table], target: Target) -> None:
    """Write Parquet with row groups of at most ROW_GROUP rows, so that memory does not grow with the capture."""
    for table in tables:
        with pa.parquet.ParquetWriter(_path(target, table, "parquet"), table.schema, compression="zstd") as file:
            for group in _row_groups(table):
                file.write_table(group, ROW_GROUP)


def write_csv(tables: Sequence[Table], target: Target) -> None:
    """Write CSV with one header row; time as UTC with nine digits, lengths in seconds; absent values are empty."""
    for table in tables:
        columns = [pa.field(field.name, CSV_TYPES.get(field.type, field.type)) for field in table.schema]
        with arrow_csv.CSVWriter(_path(target, table, "csv"), pa.schema(columns)) as file:
            for batch in table:
                cells = [_cells(cells, field.type) for cells, field in zip(batch.columns, columns, strict=True)]
                file.write_batch(pa.RecordBatch.from_arrays(cells, schema=pa.schema(columns)))


def _cells(cells: pa.Array, type_: pa.DataType) -> pa.Array:
    """Return cells as CSV has them. A double has the nanoseconds of eleven days."""
    if cells.type == DURATION:
        return pc.divide(cells.cast(pa.int64()).cast(pa.float64()), 1e9)
    return cells.cast(type_)


def _path(target: Target, table: Table, suffix: str) -> Path:
    path = target.folder / f"message={table.name}" / target.partition / f"{target.name}.{suffix}"
    path.parent.mkdir(parents=True)
    return path


def _row_groups(table: Table) -> Iterator[pa.Table]:
    held: list[pa.RecordBatch] = []
    for batch in table:
        held.append(batch)
        if sum(map(len, held)) >= ROW_GROUP:
            yield pa.Table.from_batches(held).unify_dictionaries()
            held = []
    if held:
        yield pa.Table.from_batches(held).unify_dictionaries()
