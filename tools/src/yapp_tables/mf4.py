# SPDX-License-Identifier: GPL-2.0-or-later
"""MF4 (ASAM MDF 4.10): one file a capture, a channel group for each message of each source."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from asammdf import MDF, Signal

from .sources import begin, by_source, times_of
from .tables import DURATION, TIME, Column, Table
from .writers import Target

# As the plugin numbers the reserved counts in `<field>.special`.
SPECIAL = ("nan", "inf", "-inf", "above", "below")
NANOSECONDS = 1_000_000_000


def write_mf4(tables: Sequence[Table], target: Target) -> None:
    """Write a capture: units, meanings of numbers, invalidation bits where a value is absent, the time it began at."""
    start = begin(tables) // NANOSECONDS
    with MDF(version="4.10", temporary_folder=str(target.folder.parent)) as mdf:
        mdf.header.start_time = datetime.fromtimestamp(start, UTC)
        mdf.header.comment = f"flight {target.flight_id}, yapp-tables {version('yapp-tables')}"
        for table in tables:
            _append(mdf, table, start)
        mdf.save(target.folder / f"{target.name}.mf4", compression=2, overwrite=True)


def _append(mdf: Any, table: Table, start: int) -> None:
    """Add the channel groups of one message, one for each source."""
    names, message = ("frame", "id", "seq") if table.is_message else (), table.message
    columns = [Column(name, table.rows.schema.field(name).type, "value") for name in names] + table.columns
    # An enum's text: the number's conversion says the same.
    columns = [one for one in columns if one.type != TIME
               and not (one.name.endswith("_text") and one.name.removesuffix("_text") in message.columns)]  # fmt: skip
    for source, rows in by_source(table):
        if len(rows):
            since = pc.subtract(times_of(rows, start * NANOSECONDS), start * NANOSECONDS)
            name, times = " ".join((message.name, *source)), since.to_numpy() / NANOSECONDS
            groups = name, " ".join(source)
            signals = [_signal(column, rows[column.name].combine_chunks(), times, groups) for column in columns]
            mdf.append(signals, acq_name=name, comment=message.title, common_timebase=True)


def _signal(column: Column, cells: pa.Array, times: Any, groups: tuple[str, ...]) -> Any:
    """A channel.  Its name is that of others too: it is found as `left.rpm_measured`, `motor left.rpm_measured`."""
    samples, absent = _samples(cells, column)
    values = dict(enumerate(SPECIAL)) if _is_special(column) else column.values
    conversion: dict[str, Any] = {}
    for number, (value, text) in enumerate(values.items()):
        conversion |= {f"val_{number}": value, f"text_{number}": text.encode()}
    return Signal(
        samples,
        times,
        name=column.name,
        unit="s" if column.type == DURATION else column.unit,
        comment=column.title,
        conversion=conversion or None,
        invalidation_bits=absent,
        display_names={escape(f"{group}.{column.name}"): "display" for group in groups},
        encoding="utf-8" if samples.dtype.kind == "S" else None,
    )


def _is_special(column: Column) -> bool:
    return column.role == "text" and column.name.endswith("_special")


def _samples(values: pa.Array, column: Column) -> tuple[Any, Any]:
    """The values as numpy has them, and where there are none."""
    absent = values.is_null().to_numpy(zero_copy_only=False)
    if _is_special(column):
        values = pc.index_in(values, pa.array(SPECIAL)).cast(pa.uint8())
    if pa.types.is_string(values.type):
        return np.char.encode(pc.fill_null(values, "").to_numpy(zero_copy_only=False).astype("U"), "utf-8"), absent
    if values.type == DURATION:
        return pc.fill_null(values.cast(pa.int64()), 0).to_numpy(zero_copy_only=False) / NANOSECONDS, absent
    if pa.types.is_boolean(values.type):
        values = values.cast(pa.uint8())
    return pc.fill_null(values, 0).to_numpy(zero_copy_only=False), absent
