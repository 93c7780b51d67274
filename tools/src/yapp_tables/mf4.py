# SPDX-License-Identifier: GPL-2.0-or-later
"""MF4 (ASAM MDF 4.10): one file a capture, a channel group for each message of each source."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from asammdf import MDF, Signal

from . import __version__
from .tables import HEAD, TIME, is_message, said
from .writers import Tables, begin, by_source, in_seconds

# As the plugin numbers the reserved counts in `<field>.special`.
SPECIAL = ("nan", "inf", "-inf", "above", "below")
NANOSECONDS = 1_000_000_000


def write_mf4(tables: Tables, path: Path, _: str, flight: str) -> None:
    """Write a capture: units, meanings of numbers, invalidation bits where a value is absent, the time it began at."""
    start = begin(tables.values()) // NANOSECONDS
    with MDF(version="4.10", temporary_folder=str(path.parent.parent)) as mdf:
        mdf.header.start_time = datetime.fromtimestamp(start, UTC)
        mdf.header.comment = f"flight {flight}, yapp-tables {__version__}"
        for name, rows in tables.items():
            _append(mdf, name, rows, start)
        mdf.save(path.with_name(f"{path.name}.mf4"), compression=2, overwrite=True)


def _append(mdf: Any, message: str, table: pa.Table, start: int) -> None:
    """Add the channel groups of one message, one for each source."""
    table, names = in_seconds(table), set(table.schema.names)
    left_out = HEAD.keys() - {"frame", "id", "seq"} if is_message(table) else set()
    # An enum's text: the number's conversion says the same.
    left_out |= {name for name in names if name.endswith("_text") and name.removesuffix("_text") in names}
    columns = [field for field in table.schema if field.type != TIME and field.name not in left_out]
    for source, rows, times in by_source(table, start * NANOSECONDS):
        if len(rows):
            name, since = " ".join((message, *source)), (times.to_numpy() - start * NANOSECONDS) / NANOSECONDS
            groups = name, " ".join(source)
            signals = [_signal(column, rows[column.name].combine_chunks(), since, groups) for column in columns]
            title = said(table.schema.metadata)["title"]
            mdf.append(signals, acq_name=name, comment=title, common_timebase=True)


def _signal(column: pa.Field, cells: pa.Array, times: Any, groups: tuple[str, ...]) -> Any:
    """A channel.  Its name is that of others too: it is found as `left.rpm_measured`, `motor left.rpm_measured`."""
    known = said(column.metadata)
    values = json.loads(known.get("values", "{}"))
    absent = cells.is_null().to_numpy(zero_copy_only=False)
    if column.name.endswith("_special"):
        values = dict(enumerate(SPECIAL))
        cells = pc.index_in(cells, pa.array(SPECIAL)).cast(pa.uint8())
    conversion: dict[str, Any] = {}
    for number, (value, text) in enumerate(values.items()):
        conversion |= {f"val_{number}": int(value), f"text_{number}": text.encode()}
    if pa.types.is_string(cells.type):
        samples = np.char.encode(pc.fill_null(cells, "").to_numpy(zero_copy_only=False).astype("U"), "utf-8")
    else:
        cells = cells.cast(pa.uint8()) if pa.types.is_boolean(cells.type) else cells
        samples = pc.fill_null(cells, 0).to_numpy(zero_copy_only=False)
    return Signal(
        samples,
        times,
        name=column.name,
        unit=known.get("unit", ""),
        comment=known.get("title", ""),
        conversion=conversion or None,
        invalidation_bits=absent,
        display_names={escape(f"{group}.{column.name}"): "display" for group in groups},
        encoding="utf-8" if samples.dtype.kind == "S" else None,
    )
