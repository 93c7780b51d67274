# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight-1a2b3c4d.parquet`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet

from .scalars import scalar
from .tables import DURATION, Table

ROW_GROUP = 100_000


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
        with _path(target, table, "csv").open("wb") as file:
            file.write(",".join(f'"{name}"' for name in table.schema.names).encode() + b"\n")
            for batch in table:
                lines = _join([_join([*map(_cells, batch.columns)], ","), "\n"], "")
                file.write(lines.buffers()[2][: pc.sum(pc.binary_length(lines)).as_py()])


def _join(cells: Sequence[pa.Array | str], separator: str) -> pa.Array:
    """Return texts joined row by row; what is absent is empty."""
    return pc.binary_join_element_wise(*cells, separator, null_handling="replace", null_replacement="")


def _cells(column: pa.Array) -> pa.Array:
    """Return the texts of a column; only words have quotes."""
    if column.type == DURATION:
        return _seconds(column.cast(pa.int64()))
    texts = column.cast(pa.string())
    if not pa.types.is_string(column.type) and not pa.types.is_dictionary(column.type):
        return texts
    return pc.binary_join_element_wise('"', pc.replace_substring(texts, '"', '""'), '"', "")


def _seconds(nanoseconds: pa.Array) -> pa.Array:
    """Return nanoseconds as seconds with nine digits. Arrow's decimal numbers become 0E-9 and 1E-8."""
    digits = pc.utf8_lpad(pc.replace_substring(nanoseconds.cast(pa.string()), "-", ""), 10, "0")
    seconds = pc.binary_join_element_wise(
        pc.utf8_slice_codeunits(digits, 0, -9), pc.utf8_slice_codeunits(digits, -9, None), "."
    )
    return pc.if_else(pc.less(nanoseconds, scalar(0)), pc.binary_join_element_wise("-", seconds, ""), seconds)


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
