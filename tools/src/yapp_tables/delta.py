# SPDX-License-Identifier: GPL-2.0-or-later
"""Delta Lake: a table for each message, `data/message=motor`, in which a transaction replaces the rows of a flight."""

import errno
import os
import random
import re
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import pyarrow as pa
from deltalake import DeltaTable, write_deltalake
from deltalake.exceptions import DeltaError, TableNotFoundError

from .errors import YappError
from .tables import DURATION, KIND
from .writers import Tables

# Several writers of one table: a transaction that another one overtook is tried again.
TRIES = 50
# deltalake's errors are trees of several lines in colours.
COLOURS = re.compile(r"\x1b\[\d*m|↳")
# Delta knows no unsigned integers, no durations (they are integers of nanoseconds), and times of microseconds only:
# time_ns has the nanoseconds.
TYPES = {
    KIND: pa.string(),
    DURATION: pa.int64(),
    pa.uint8(): pa.int16(),
    pa.uint16(): pa.int32(),
    pa.uint32(): pa.int64(),
    pa.uint64(): pa.decimal128(20, 0),
    pa.timestamp("ns", "UTC"): pa.timestamp("us", "UTC"),
}


def write_delta(tables: Tables, _: Path, url: str, flight: str) -> None:
    """Put the rows of a flight in place of those that are there; a column that is new extends the table."""
    how = {"mode": "overwrite", "predicate": f"flight_id = '{flight}'", "schema_mode": "merge"}
    for name, rows in tables.items():
        _again(partial(write_deltalake, f"{url}/message={name}", _rows(rows), **how))


def delete(url: str, flight: str, messages: Iterable[str]) -> None:
    """Remove the rows of a flight."""
    for place in (f"{url}/message={name}" for name in messages):
        _again(lambda place=place: DeltaTable(place).delete(f"flight_id = '{flight}'"))  # type: ignore[misc]


def _again(work: Callable[[], object]) -> None:
    for number in range(TRIES):
        try:
            work()
            return
        except TableNotFoundError:
            return
        except (DeltaError, OSError) as error:  # an OSError of deltalake's has no number
            text = " ".join(COLOURS.sub("", str(error)).split())
            if os.strerror(errno.ENOSPC) in text:
                raise OSError(errno.ENOSPC, text) from error
            if number == TRIES - 1 or isinstance(error, OSError):
                raise YappError(f"Delta Lake: {text}") from error
            time.sleep(random.uniform(0, 0.2))


def _rows(rows: pa.Table) -> pa.Table:
    """Return rows with types that Delta knows."""
    if "time" in rows.schema.names:
        rows = rows.append_column("time_ns", rows["time"].cast(pa.int64()))
    fields = [field.with_type(TYPES.get(field.type, field.type)) for field in rows.schema]
    return rows.cast(pa.schema(fields), safe=False)
