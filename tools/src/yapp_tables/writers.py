# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight-1a2b3c4d.parquet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from .tables import DURATION, KIND, Table

ROW_GROUP = 100_000
CSV_TYPES = {KIND: pa.string(), DURATION: pa.decimal128(19, 9)}


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
    """Write CSV with one header row; time as UTC and lengths in seconds, with nine digits; absent values are empty."""
    for table in tables:
        schema = pa.schema([field.with_type(CSV_TYPES.get(field.type, field.type)) for field in table.schema])
        with pa.csv.CSVWriter(_path(target, table, "csv"), schema) as file:
            for batch in table:
                columns = [_cells(column, field.type) for column, field in zip(batch.columns, schema, strict=True)]
                file.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))


def _cells(column: pa.Array, type_: pa.DataType) -> pa.Array:
    if column.type != DURATION:
        return column.cast(type_)
    # A count of nanoseconds, read as a number with nine decimals.
    return column.cast(pa.int64()).cast(pa.decimal128(19, 0)).view(type_)


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
