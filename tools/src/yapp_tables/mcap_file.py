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
from .tables import Table
from .writers import Target

# MCAP has the time itself; the rest stands once, in /flights.
LEFT_OUT = ("time", "source_file", "flight_id")


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
    schema = writer.register_schema(table.name, "jsonschema", json.dumps(_schema(table)).encode())
    channels: dict[str, int] = {}
    for source, batch in by_source(table):
        topic = "/".join(("", table.name, *source))
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "json", schema)
        for time, text in zip(times_of(batch, start).to_pylist(), _json(batch).to_pylist(), strict=True):
            writer.add_message(channels[topic], time, text, time)


def _schema(rows: Table) -> dict[str, Any]:
    """A JSON schema; each property names its title, with its unit."""
    properties = {}
    for field in rows.schema:
        if field.name not in LEFT_OUT or rows.name == "flights":
            about = {key.decode(): text.decode() for key, text in (field.metadata or {}).items()}
            unit = f" [{about['unit']}]" if "unit" in about else ""
            properties[field.name] = {"type": _type(field.type), "description": about.get("title", field.name) + unit}
    return {"title": rows.message.name, "type": "object", "properties": properties}


def _type(type_: pa.DataType) -> str:
    if pa.types.is_boolean(type_):
        return "boolean"
    if pa.types.is_integer(type_):
        return "integer"
    return "number" if pa.types.is_floating(type_) else "string"


def _json(batch: pa.RecordBatch) -> pa.Array:
    """Each row as a JSON object, made column by column; absent values are left out."""
    pieces: list[Any] = []
    for field, column in zip(batch.schema, batch.columns, strict=True):
        if (field.name in LEFT_OUT and "capture" not in batch.schema.names) or column.null_count == len(column):
            continue
        comma = "," if pieces else "{"
        text = pc.binary_join_element_wise(f"{comma}{json.dumps(field.name)}:", _texts(column), "")
        pieces.append(pc.fill_null(text, ""))
    return pc.binary_join_element_wise(*pieces, "}", "").cast(pa.binary())


def _texts(column: pa.Array) -> pa.Array:
    """A column's values as JSON writes them, null where there is none."""
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.string())
    if pa.types.is_string(column.type):
        coded = column.dictionary_encode()
        escaped = pa.array([json.dumps(text, ensure_ascii=False) for text in coded.dictionary.to_pylist()], pa.string())
        return escaped.take(coded.indices)
    if pa.types.is_floating(column.type):
        column = pc.if_else(pc.is_finite(column), column, None)
    return column.cast(pa.string())
