# SPDX-License-Identifier: GPL-2.0-or-later
"""Tables that say what happened in a flight: events, faults, summary, steps, points, and the flight itself."""

from __future__ import annotations

import json
from collections.abc import Iterable
from decimal import Decimal
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from .steps import POINTS, STEPS
from .tables import KIND, SCHEMA, TIME, repeated
from .tables import column as arrow_column
from .tshark import Record

# The types of fields.json's statistics. What has another type is an object or a list: it goes into `other`.
TYPES = {"time": TIME, "id": pa.uint32(), "integer": pa.int64(), "number": pa.float64(), "seconds": pa.float64()}
TYPES |= {"boolean": pa.bool_(), "string": KIND, "text": pa.string()}
CONTROLLER = "controller", "string", "the same name: all messages of a controller have it"
OTHER = "other", "text", "what the plugin says besides, as JSON: keys that have no column of their own"
# A table of this package: name, type, meaning, unit. The plugin describes events, faults and summary.
FLIGHTS = (
    ("capture", "text", "the path of the capture, when it was converted", ""),
    ("start", "time", "the first message, UTC; null where the capture tells no absolute time", ""),
    ("length", "number", "from the first message to the last; without steps of the clock", "s"),
    ("is_absolute", "boolean", "whether the capture tells the date; if not, times count from 1970", ""),
    ("clock_resets", "integer", "how often the capture's clock was set: events `clock` of more than a second", ""),
    ("plugin", "string", "the version of the plugin", ""),
    ("tools", "string", "the version of yapp-tables", ""),
    ("options", "string", "the preferences", ""),
    ("messages", "integer", "rows of all messages", ""),
    ("faults", "integer", "incidents with a fault; events of a controller at most 2 s apart are one incident", ""),
    ("partial", "text", "why the capture was read only in part", ""),
    ("left_out", "text", "which messages were not decoded, and what to know of the times and of copies", ""),
)
TABLES = ("events", "faults", "summary", "steps", "points", "flights")


def column(name: str, type_: str, meaning: str, unit: str = "") -> pa.Field:
    """Return a column of a record; type_: a word of TYPES."""
    return arrow_column(name, TYPES[type_], "text" if TYPES[type_] in (KIND, pa.string()) else "value", meaning, unit)


def columns_of(fields: Record, name: str) -> pa.Schema:
    """Return the columns of a table: as the plugin's fields.json describes them, or those of this package."""
    own = {"flights": FLIGHTS, "steps": STEPS, "points": POINTS}
    if name in own:
        return pa.schema([column(*each) for each in own[name]])
    described = fields["statistics"][name]["columns"]
    if name == "events":  # a fault is an event, too
        more = fields["statistics"]["faults"]["columns"]
        described = {each["name"]: each for each in (*described, *more)}.values()
    found = [
        column(each["name"], each["type"], each.get("help") or each.get("title") or "", each.get("unit") or "")
        for each in described
        if each["type"] in TYPES
    ]
    found.insert([each.name for each in found].index("source") + 1, column(*CONTROLLER))
    return pa.schema(found if name == "faults" else [*found, column(*OTHER)])


def table(records: Iterable[Record], columns: pa.Schema) -> pa.Table:
    """Return JSON lines of a statistic as a table; keys without a column come as JSON in `other`."""
    return pa.Table.from_pylist([_cells(record, columns) for record in records], columns)


def _cells(record: Record, columns: pa.Schema) -> Record:
    cells = {each.name: _cell(each.type, record.get(each.name)) for each in columns}
    if "controller" in cells:
        cells["controller"] = record.get("source")
    more = {key: value for key, value in record.items() if key not in cells.keys() | {"values"} and value is not None}
    if "other" in cells and more:
        cells["other"] = json.dumps(more, ensure_ascii=False, default=float)
    return cells


def _cell(type_: pa.DataType, value: Any) -> Any:
    if value is None:
        return None
    if type_ == TIME:
        return int(Decimal(value).scaleb(9))
    if type_ in (KIND, pa.string()):
        return str(value)
    return float(value) if isinstance(value, Decimal) else value


def faults(events: pa.Table, columns: pa.Schema) -> pa.Table:
    """Return the flags that were raised and cleared, of all events."""
    is_fault = pc.equal(events["kind"].cast(pa.string()), "fault")
    return events.filter(is_fault).select([name for name in columns.names if name in events.schema.names])


def to_write(name: str, rows: pa.Table, flight: Record) -> pa.Table:
    """Return records with flight_id and source_file, and `message_name`: `message` would be taken for the folder's."""
    names = ["message_name" if each == "message" else each for each in rows.schema.names]
    about = {"title": name.title(), "schema": str(SCHEMA)}
    rows = rows.rename_columns(names).unify_dictionaries().replace_schema_metadata(about)
    for at, key in enumerate(("flight_id", "source_file")):
        head = arrow_column(key, KIND, "text")
        rows = rows.add_column(at, head, repeated(flight[key], len(rows)))
    return rows
