# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight.parquet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from .tables import Rows, present
from .tshark import Export

ROW_GROUP = 100_000

# A writer: what to write, what `source_file` says, the result's name (of its files), the folder to write to; returns
# the number of messages written.
Writer = Callable[[Export, str, str, Path], int]


def write_parquet(export: Export, source_file: str, name: str, folder: Path) -> int:
    """Parquet with row groups of at most ROW_GROUP rows, so that memory does not grow with the capture."""
    total = 0
    for message in present(export):
        rows = Rows(export, message, source_file)
        path = _path(folder, message.name, f"{name}.parquet")
        with pa.parquet.ParquetWriter(path, rows.schema, compression="zstd") as file:
            for group in _row_groups(rows):
                file.write_table(group, ROW_GROUP)
                total += len(group)
    return total


def write_csv(export: Export, source_file: str, name: str, folder: Path) -> int:
    """CSV with one header row; time as UTC with nine digits; absent values and reserved counts are empty cells."""
    total = 0
    for message in present(export):
        rows = Rows(export, message, source_file)
        with pa.csv.CSVWriter(_path(folder, message.name, f"{name}.csv"), rows.schema) as file:
            for batch in rows:
                file.write_batch(_finite(batch))
                total += len(batch)
    return total


def _finite(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Without NaN and infinities: many a reader would take the whole column for text."""
    floating = (pa.types.is_floating(field.type) for field in batch.schema)
    columns = [pc.if_else(pc.is_finite(c), c, None) if f else c for c, f in zip(batch.columns, floating, strict=True)]
    return pa.RecordBatch.from_arrays(columns, schema=batch.schema)


def _path(folder: Path, message: str, name: str) -> Path:
    path = folder / f"message={message}" / name
    path.parent.mkdir(parents=True)
    return path


def _row_groups(rows: Rows) -> Iterator[pa.Table]:
    held: list[pa.RecordBatch] = []
    for batch in rows:
        held.append(batch)
        if sum(map(len, held)) >= ROW_GROUP:
            yield pa.Table.from_batches(held)
            held = []
    if held:
        yield pa.Table.from_batches(held)
