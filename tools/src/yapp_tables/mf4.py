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
from .tables import DURATION, TIME, Column, Rows, Table
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
            _Groups(mdf, table, start).write()
        mdf.save(target.folder / f"{target.name}.mf4", compression=2, overwrite=True)


class _Groups:
    """The channel groups of one message, one for each source."""

    def __init__(self, mdf: Any, rows: Table, start: int) -> None:
        self.mdf, self.rows, self.start = mdf, rows, start
        self.groups: dict[tuple[str, ...], int] = {}
        names = ("frame", "id", "seq") if isinstance(rows, Rows) else ()
        columns = [Column(name, rows.schema.field(name).type, "value") for name in names] + rows.columns
        self.columns = [column for column in columns if column.type != TIME and not self._is_meaning(column)]

    def write(self) -> None:
        """Add all rows."""
        for source, rows in by_source(self.rows):
            if not len(rows):
                continue
            since = pc.subtract(times_of(rows, self.start * NANOSECONDS), self.start * NANOSECONDS)
            times = since.to_numpy() / NANOSECONDS
            samples = [(column, *_samples(rows[column.name].combine_chunks(), column)) for column in self.columns]
            if source in self.groups:
                self.mdf.extend(
                    self.groups[source], [(times, None), *((array, absent) for _, array, absent in samples)]
                )
            else:
                name = " ".join((self.rows.message.name, *source))
                groups = name, " ".join(source)
                signals = [self._signal(column, array, absent, times, groups) for column, array, absent in samples]
                self.groups[source] = self.mdf.append(
                    signals, acq_name=name, comment=self.rows.message.title, common_timebase=True
                )

    def _is_meaning(self, column: Column) -> bool:
        """An enum's text: the number's conversion says the same."""
        return column.name.endswith("_text") and column.name.removesuffix("_text") in self.rows.message.columns

    def _signal(self, column: Column, samples: Any, absent: Any, times: Any, groups: tuple[str, ...]) -> Any:
        """A channel.  Its name is that of others too: it is found as `left.rpm_measured`, `motor left.rpm_measured`."""
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
