# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight-1a2b3c4d.parquet`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv as arrow_csv

from .tables import DURATION, KIND, Table

ROW_GROUP = 100_000
CSV_TYPES = {KIND: pa.string(), DURATION: pa.float64()}


@dataclass(frozen=True)
class Target:
    """Where a writer writes. folder: for its files; name: of the files; url: of the whole data set."""

    folder: Path
    name: str
    url: str
    flight_id: str


Writer = Callable[[Sequence[Table], Target], None]


def write_parquet(tables: Sequence[Table], target: Target) -> None:
    """Write Parquet with row groups of at most ROW_GROUP rows."""
    for table in tables:
        pq.write_table(table.rows, _path(target, table, "parquet"), ROW_GROUP, compression="zstd")


def write_csv(tables: Sequence[Table], target: Target) -> None:
    """Write CSV with one header row; time as UTC with nine digits, lengths in seconds; absent values are empty."""
    for table in tables:
        cells = [_cells(cells, CSV_TYPES.get(cells.type, cells.type)) for cells in table.rows.columns]
        arrow_csv.write_csv(pa.table(cells, table.rows.schema.names), _path(target, table, "csv"))


def _cells(cells: pa.ChunkedArray, type_: pa.DataType) -> pa.ChunkedArray:
    """Return cells as CSV has them. A double has the nanoseconds of eleven days."""
    if cells.type == DURATION:
        return pc.divide(cells.cast(pa.int64()).cast(pa.float64()), 1e9)
    return cells.cast(type_)


def _path(target: Target, table: Table, suffix: str) -> Path:
    path = target.folder / f"message={table.name}" / f"{target.name}.{suffix}"
    path.parent.mkdir()
    return path
