# SPDX-License-Identifier: GPL-2.0-or-later
"""MCAP: one file a capture, a topic for each source (`/motor/can0/0x210`), messages and their schemas as JSON."""

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
from mcap.writer import Writer

from . import __version__
from .tables import TIME, said
from .writers import Tables, begin, by_source, in_seconds

# MCAP has the time itself; the rest stands once, in `flights`.
LEFT_OUT = ("time", "source_file", "flight_id")


def write_mcap(tables: Tables, path: Path, *_: str) -> None:
    """Write a capture. A value that is absent or reserved is left out; `_special` says which. Lengths are seconds."""
    start = begin(tables.values())
    with path.with_name(f"{path.name}.mcap").open("wb") as file:
        writer: Any = Writer(file)
        writer.start(library=f"yapp-tables {__version__}")
        for name, rows in tables.items():
            _write(writer, name, rows, start)
        writer.finish()


def _write(writer: Any, name: str, table: pa.Table, start: int) -> None:
    table = in_seconds(table)
    names = [each for each in table.schema.names if each not in LEFT_OUT or name == "flights"]
    # As Foxglove reads it.
    properties = {each: _property(table.schema.field(each)) for each in names}
    about = {"title": name, "description": said(table.schema.metadata)["title"], "type": "object"}
    schema = writer.register_schema(name, "jsonschema", json.dumps(about | {"properties": properties}).encode())
    for source, rows, times in by_source(table, start):
        channel = writer.register_channel("/".join(("", name, *source)), "json", schema)
        cells = [rows[each].cast(pa.string()) if rows[each].type == TIME else rows[each] for each in names]
        for time, row in zip(times.to_pylist(), pa.table(cells, names).to_pylist(), strict=True):
            there = {key: value for key, value in row.items() if value is not None}
            writer.add_message(channel, time, json.dumps(there, ensure_ascii=False).encode(), time)


def _property(column: pa.Field) -> dict[str, Any]:
    """Return what the schema says of a column; an enum is a `oneOf` of constants with titles."""
    known = said(column.metadata)
    unit, title = known.get("unit", ""), known.get("title", column.name)
    kinds = {"boolean": pa.types.is_boolean, "integer": pa.types.is_integer, "number": pa.types.is_floating}
    type_ = next((name for name, is_it in kinds.items() if is_it(column.type)), "string")
    about: dict[str, Any] = {"type": type_, "title": title}
    about["description"] = f"{title} [{unit}]" if unit else title
    about |= {key: text for key, text in (("unit", unit), ("filter", known.get("filter"))) if text}
    if values := json.loads(known.get("values", "{}")):
        about["oneOf"] = [{"title": text, "const": int(number)} for number, text in values.items()]
    return about
