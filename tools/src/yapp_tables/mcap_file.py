# SPDX-License-Identifier: GPL-2.0-or-later
"""MCAP: one file a capture, a topic for each source (`/motor/can0/0x210`), messages and their schemas as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import pyarrow as pa
from mcap.writer import Writer

from .sources import begin, by_source, times_of
from .tables import TIME, Table
from .writers import Target

# MCAP has the time itself; the rest stands once, in /flights.
LEFT_OUT = ("time", "source_file", "flight_id")
NO_JSON = (None, math.inf, -math.inf)


def write_mcap(tables: Sequence[Table], target: Target) -> None:
    """Write a capture. A value that is absent, or no number that JSON has, is left out; `_special` says which."""
    start = begin(tables)
    with (target.folder / f"{target.name}.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start(library=f"yapp-tables {version('yapp-tables')}")
        for table in tables:
            _write(writer, table, start)
        writer.finish()


def _write(writer: Any, table: Table, start: int) -> None:
    names = [name for name in table.schema.names if name not in LEFT_OUT or table.name == "flights"]
    schema = writer.register_schema(table.name, "jsonschema", json.dumps(_schema(table, names)).encode())
    fields = map(table.schema.field, names)
    plain = pa.schema([field.with_type(pa.string()) if field.type == TIME else field for field in fields])
    channels: dict[str, int] = {}
    for source, rows in by_source(table):
        topic = "/".join(("", table.name, *source))
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "json", schema)
        for time, row in zip(
            times_of(rows, start).to_pylist(), rows.select(names).cast(plain).to_pylist(), strict=True
        ):
            there = {name: value for name, value in row.items() if value == value and value not in NO_JSON}
            text = json.dumps(there, ensure_ascii=False)
            writer.add_message(channels[topic], time, text.encode(), time)


def _schema(table: Table, names: list[str]) -> dict[str, Any]:
    """A JSON schema; each property names its title, with its unit."""
    properties = {}
    for field in map(table.schema.field, names):
        about = {key.decode(): text.decode() for key, text in (field.metadata or {}).items()}
        unit = f" [{about['unit']}]" if "unit" in about else ""
        properties[field.name] = {"type": _type(field.type), "description": about.get("title", field.name) + unit}
    return {"title": table.message.name, "type": "object", "properties": properties}


def _type(type_: pa.DataType) -> str:
    if pa.types.is_boolean(type_):
        return "boolean"
    if pa.types.is_integer(type_):
        return "integer"
    return "number" if pa.types.is_floating(type_) else "string"
