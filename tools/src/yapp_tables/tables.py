# SPDX-License-Identifier: GPL-2.0-or-later
"""What fields.json and the plugin's CSV say, as Arrow schemas and tables. The metadata of a table describes it.

Of a column: title, unit, display filter, role, and as JSON the meanings of an enum's numbers. A role is "value",
"clock", "enum", "flags", "flag" or "text" (also an enum's meaning, a reserved value's name).
"""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv

from .tshark import Export, Record

# The version of a data set, `schema` in the metadata of each table: raised when a column gets another name, type or
# meaning.
SCHEMA = 6
TIME = pa.timestamp("ns", tz="UTC")
DURATION = pa.duration("ns")
# A text of few kinds.  All tables have the same type for the same column: they are joined by it.
KIND = pa.dictionary(pa.int32(), pa.string())
# Every message's first columns: type and meaning.  The CSV has no source_file, controller and flight_id.
ABOUT_HEAD = {
    "time": (TIME, "when the message was complete, UTC, by the clock of the recorder"),
    "source_file": (KIND, "the name of the capture"),
    "bus": (KIND, "the name of the bus or line; null where the capture names none"),
    "frame": (pa.int64(), "the number of the message's last packet in the capture"),
    "source": (KIND, "the name that `yapp.sources` gives to the ID; null without a name"),
    "controller": (KIND, "the same name: Motor Data, Health and Command of a controller have it in common"),
    "id": (pa.uint32(), "the message ID"),
    "seq": (pa.uint8(), "the sequence number"),
    "flight_id": (KIND, "of the capture's content: the first 16 digits of its SHA-256"),
}
HEAD = {name: type_ for name, (type_, _) in ABOUT_HEAD.items()}
# The types of fields.json that need no second look, and their roles.  A time is the controller's own clock.
ROLES = {
    "float": (pa.float64(), "value"),
    "time": (DURATION, "clock"),
    "bool": (pa.bool_(), "flag"),
    "string": (pa.string(), "text"),
}


def said(metadata: Mapping[bytes, bytes] | None) -> dict[str, str]:
    """Return the metadata of a table or a column as texts."""
    return {key.decode(): text.decode() for key, text in (metadata or {}).items()}


def is_message(rows: pa.Table) -> bool:
    """Return whether rows are the messages of sources, and no events or the like."""
    return b"every" in (rows.schema.metadata or {})


def column(name: str, type_: pa.DataType, role: str, *about: str, values: Record | None = None) -> pa.Field:
    """Return a column. about: its title, unit and filter; values: the meanings of an enum's numbers."""
    known = dict(zip(("title", "unit", "filter"), about, strict=False)) | {"role": role}
    known |= {"unit": "ns"} if type_ == DURATION else {}
    known |= {"values": json.dumps(values, ensure_ascii=False)} if values else {}
    return pa.field(name, type_, metadata={key: text for key, text in known.items() if text})


def messages(fields: Record) -> dict[str, pa.Schema]:
    """Return the messages of the catalogue in fields.json by name, each with all columns."""
    found = {}
    for name, entry in fields["messages"].items():
        given = {each["name"]: each for each in entry["columns"] if each["name"] not in (*HEAD, "crc_good")}
        columns = [_column(each, given.keys()) for each in given.values()]
        for each in differences(entry):
            about = each["title"], each["unit"] or "", f"taurus.{name}.{each['name']}"
            columns.append(column(each["name"], pa.float64(), "value", *about))
        whole = {"message": name, "title": entry["title"] or name, "every": str(entry.get("every") or "")}
        head = [pa.field(each, type_) for each, type_ in HEAD.items()]
        found[name] = pa.schema([*head, *columns], whole | {"schema": str(SCHEMA)})
    return found


def differences(entry: Record) -> list[Record]:
    """Return the values of a message that are a column `of` less a column `less`."""
    return [row for row in entry.get("formulas") or () if row["operator"] == "-"]


def _column(entry: Record, names: Iterable[str]) -> pa.Field:
    name, kind = entry["name"], entry["type"]
    if kind in ROLES:
        type_, role = ROLES[kind]
        if kind == "string" and name.removesuffix("_text").removesuffix("_special") in set(names) - {name}:
            type_ = KIND
    else:
        sign = "" if entry["kind"] == "int" else "u"
        type_ = getattr(pa, f"{sign}int{next(size for size in (8, 16, 32, 64) if size >= entry['bits'])}")()
        role = "enum" if entry.get("values") is not None else "flags" if entry["kind"] == "flags" else "value"
    about = entry.get("title") or name, entry.get("unit") or "", entry.get("filter") or ""
    return column(name, type_, role, *about, values=entry.get("values"))


def catalogue_version(fields: Record) -> str:
    """Return the messages of the catalogue, and a short name of what it says of all of them."""
    text = json.dumps(fields["messages"], sort_keys=True)
    return f"{', '.join(fields['messages'])} ({hashlib.sha256(text.encode()).hexdigest()[:8]})"


def read_rows(export: Export, name: str, flight: Record) -> pa.Table:
    """Return the rows of one message in an export. flight: {"source_file", "flight_id"}."""
    schema = messages(export.fields)[name]
    less = {each["name"]: (each["of"], each["less"]) for each in differences(export.fields["messages"][name])}
    given = _read_csv(export.csv(name), schema)
    count = len(given["time"])
    given |= {key: repeated(text, count) for key, text in flight.items()} | {"controller": given["source"]}
    for field in schema:
        if field.name in less:
            # Nine digits: 0.3, not 0.30000000000000004, for 0.8 less 0.5.
            both = (given[part].cast(pa.float64()) for part in less[field.name])
            given[field.name] = pc.round(pc.subtract(*both), 9)
        elif field.type in (TIME, DURATION) and field.name in given:
            # Seconds as text with nine digits are nanoseconds once the point is gone.
            given[field.name] = pc.replace_substring(given[field.name], ".", "").cast(pa.int64()).cast(field.type)
    cells = [given[each.name] if each.name in given else pa.nulls(count, each.type) for each in schema]
    return pa.table(cells, schema=schema).unify_dictionaries()


def _read_csv(path: Path, schema: pa.Schema) -> dict[str, Any]:
    """Return the columns of a table of the plugin, times as text. An empty cell is null."""
    with path.open(encoding="utf-8", newline="") as file:
        names = [name for name in next(csv.reader(file)) if name in schema.names]
    types = {field.name: pa.string() if field.type in (TIME, DURATION) else field.type for field in schema}
    has_text = any(types[name] == pa.string() and name != "time" for name in names)
    found = arrow_csv.read_csv(
        path,
        # One thread: a fleet has a capture for every core.
        read_options=arrow_csv.ReadOptions(use_threads=False),
        parse_options=arrow_csv.ParseOptions(newlines_in_values=has_text),
        convert_options=arrow_csv.ConvertOptions(
            column_types={name: types[name] for name in names},
            include_columns=names,
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=False,
        ),
    )
    return dict(zip(found.schema.names, found.columns, strict=True))


def present(export: Export) -> list[str]:
    """Return the messages that the export has rows of, in the catalogue's order: more than a header."""

    def has_rows(path: Path) -> bool:
        with path.open("rb") as file:
            return len(list(zip(range(2), file, strict=False))) == 2

    paths = {name: export.csv(name) for name in export.fields["messages"]}
    return [name for name, path in paths.items() if path.is_file() and has_rows(path)]


def plain(table: pa.Table) -> pa.Table:
    """Return a table without dictionaries, for formats and functions that know none."""
    fields = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in table.schema]
    return table.cast(pa.schema(fields, metadata=table.schema.metadata))


def repeated(text: str, count: int) -> Any:
    """Return a column of texts that are all this one."""
    return pa.repeat(text, count).dictionary_encode() if count else pa.array([], KIND)
