# SPDX-License-Identifier: GPL-2.0-or-later
"""Parquet and CSV: a file for each message, partitioned as `message=motor/flight-1a2b3c4d.parquet`."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import csv as arrow_csv

from .series import split
from .tables import DURATION, is_message, plain

ROW_GROUP = 100_000
Tables = Mapping[str, pa.Table]
# Of the tables of a flight, the path of its files without a suffix, the URL of the data set, and the flight_id.
Writer = Callable[[Tables, Path, str, str], None]


def write_parquet(tables: Tables, path: Path, *_: str) -> None:
    """Write Parquet with row groups of at most ROW_GROUP rows."""
    for name, rows in tables.items():
        pq.write_table(rows, _path(path, name, "parquet"), ROW_GROUP, compression="zstd")


def write_csv(tables: Tables, path: Path, *_: str) -> None:
    """Write CSV with one header row; time as UTC with nine digits, lengths in seconds; absent values are empty."""
    for name, rows in tables.items():
        arrow_csv.write_csv(in_seconds(plain(rows)), _path(path, name, "csv"))


def in_seconds(rows: pa.Table) -> pa.Table:
    """Return rows whose durations are numbers of seconds. A double has the nanoseconds of eleven days."""
    for at, field in enumerate(rows.schema):
        if field.type == DURATION:
            numbers = pc.divide(rows[at].cast(pa.int64()).cast(pa.float64()), 1e9)
            known = (field.metadata or {}) | {b"unit": b"s"}
            rows = rows.set_column(at, field.with_type(pa.float64()).with_metadata(known), numbers)
    return rows


def _path(path: Path, name: str, suffix: str) -> Path:
    folder = path.parent / f"message={name}"
    folder.mkdir()
    return folder / f"{path.name}.{suffix}"


# ---- MF4 and MCAP keep each source by itself: four controllers in one channel would be a zigzag


def by_source(table: pa.Table, start: int) -> Iterator[tuple[tuple[str, ...], pa.Table, pa.Array]]:
    """Return name, rows and times of each source; bus and ID are two words of a name.

    What is no message stays together, and has no name. Times are nanoseconds since 1970, start where there is none.
    """
    for name, own in split(plain(table)) if is_message(table) else [("", plain(table))]:
        rows, is_named = own.combine_chunks(), is_message(table) and own["source"][0].is_valid
        times = rows["time"].cast(pa.int64()) if "time" in rows.schema.names else pa.nulls(len(rows), pa.int64())
        yield (name,) if is_named else tuple(name.split()), rows, pc.fill_null(times, start)


def begin(tables: Iterable[pa.Table]) -> int:
    """Return the time of the first message, in nanoseconds since 1970."""
    return int(min(rows["time"][0].value for rows in tables if is_message(rows)))
