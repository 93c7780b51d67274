# SPDX-License-Identifier: GPL-2.0-or-later
"""MCAP: one file a capture, a topic for each source (`/motor/can0/0x210`), messages and their schemas as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from mcap.writer import Writer

from .sources import begin, by_source, times_of
from .tables import DURATION, TIME, Column, Table
from .writers import Target

# MCAP has the time itself; the rest stands once, in the metadata `flight`.
LEFT_OUT = ("time", "source_file", "flight_id")


def write_mcap(tables: Sequence[Table], target: Target) -> None:
    """Write a capture. A value that is absent or reserved is left out; `_special` says which. Lengths are seconds."""
    start = begin(tables)
    with (target.folder / f"{target.name}.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start(library=f"yapp-tables {version('yapp-tables')}")
        for table in tables:
            _write(writer, table, start)
        writer.finish()


def _write(writer: Any, table: Table, start: int) -> None:
    names = [name for name in table.rows.schema.names if name not in LEFT_OUT or table.name == "flights"]
    schema = writer.register_schema(table.name, "jsonschema", json.dumps(_schema(table, names)).encode())
    for source, rows in by_source(table):
        about = {"controller": source[0]} if len(source) == 1 and source[0] else {}
        channel = writer.register_channel("/".join(("", table.name, *source)), "json", schema, about)
        for time, row in zip(times_of(rows, start).to_pylist(), _plain(rows.select(names)).to_pylist(), strict=True):
            there = {name: value for name, value in row.items() if value is not None}
            writer.add_message(channel, time, json.dumps(there, ensure_ascii=False).encode(), time)
            if table.name == "flights":
                writer.add_metadata("flight", {name: str(value) for name, value in there.items()})


def _plain(rows: pa.Table) -> pa.Table:
    """Return rows whose cells JSON knows: times as text, lengths in seconds."""
    for number, field in enumerate(rows.schema):
        if field.type == TIME:
            rows = rows.set_column(number, field.name, rows[number].cast(pa.string()))
        if field.type == DURATION:
            rows = rows.set_column(number, field.name, pc.divide(rows[number].cast(pa.int64()).cast(pa.float64()), 1e9))
    return rows


def _schema(table: Table, names: Sequence[str]) -> dict[str, Any]:
    """A JSON schema as Foxglove reads it: an enum is a `oneOf` of constants with titles."""
    known = {column.name: column for column in table.columns}
    properties = {
        name: _property(known.get(name) or Column(name, table.rows.schema.field(name).type, "")) for name in names
    }
    about = {"title": table.message.name, "description": table.message.title}
    return about | {"type": "object", "properties": properties}


def _property(column: Column) -> dict[str, Any]:
    """Its title is the field's, its description has the unit, too; `unit` and `filter` stand by themselves."""
    unit = "s" if column.type == DURATION else column.unit
    title = column.title or column.name
    about: dict[str, Any] = {"type": _type(column.type), "title": title}
    about["description"] = f"{title} [{unit}]" if unit else title
    about |= {key: text for key, text in (("unit", unit), ("filter", column.filter)) if text}
    if column.values:
        about["oneOf"] = [{"title": text, "const": number} for number, text in column.values.items()]
    return about


def _type(type_: pa.DataType) -> str:
    if pa.types.is_boolean(type_):
        return "boolean"
    if pa.types.is_integer(type_):
        return "integer"
    return "number" if pa.types.is_floating(type_) or type_ == DURATION else "string"
