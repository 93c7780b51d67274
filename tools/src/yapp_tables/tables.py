# SPDX-License-Identifier: GPL-2.0-or-later
"""What fields.json and the plugin's CSV say, as Arrow schemas and tables. The metadata of a table describes it.

Of a column: title, unit, display filter, role, and as JSON the meanings of an enum's numbers. A role is "value",
"clock", "enum", "flags", "flag" or "text" (also an enum's meaning, a reserved value's name).
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv

from .tshark import Record

# The version of a data set, `schema` in the metadata of each table: raised when a column gets another name, type or
# meaning.
SCHEMA = 6
TIME = pa.timestamp("ns", tz="UTC")
DURATION = pa.duration("ns")
# A text of few kinds.  All tables have the same type for the same column: they are joined by it.
KIND = pa.dictionary(pa.int32(), pa.string())
# The types of fields.json's statistics. What has another type is an object or a list: it goes into `other`.
TYPES = {"time": TIME, "id": pa.uint32(), "integer": pa.int64(), "number": pa.float64(), "seconds": pa.float64()}
TYPES |= {"boolean": pa.bool_(), "string": KIND, "text": pa.string(), "byte": pa.uint8()}
# Columns that this package adds, described as fields.json describes those of the plugin. head: the first columns of
# every message; the CSV has no source_file, controller and flight_id.
OWN: dict[str, list[Record]] = json.loads(Path(__file__).with_name("tables.json").read_text(encoding="utf-8"))
HEAD = {each["name"]: TYPES[each["type"]] for each in OWN["head"]}
TABLES = ("events", "faults", "summary", "buses", "steps", "points", "flights")
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
    """Return the values of a message that are a column `of` less a column `less`, and no column of the CSV."""
    known = {each["name"] for each in entry["columns"]}
    return [row for row in entry.get("formulas") or () if row["operator"] == "-" and row["name"] not in known]


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


def read_rows(path: Path, schema: pa.Schema, entry: Record, flight: Record) -> pa.Table:
    """Return the rows of a message, of the plugin's CSV. entry: of fields.json; flight: source_file and flight_id."""
    types = {field.name: pa.string() if field.type in (TIME, DURATION) else field.type for field in schema}
    given = arrow_csv.read_csv(
        path,
        # One thread: a fleet has a capture for every core.
        read_options=arrow_csv.ReadOptions(use_threads=False),
        parse_options=arrow_csv.ParseOptions(newlines_in_values=pa.string() in [field.type for field in schema]),
        convert_options=arrow_csv.ConvertOptions(
            column_types=types,
            include_columns=schema.names,
            include_missing_columns=True,
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=False,
        ),
    )
    columns = dict(zip(schema.names, given.columns, strict=True))
    columns |= {key: repeated(text, len(given)) for key, text in flight.items()} | {"controller": columns["source"]}
    for name in (name for name, type_ in types.items() if type_ != schema.field(name).type):
        # Seconds as text with nine digits are nanoseconds once the point is gone.
        whole = pc.replace_substring(columns[name], ".", "").cast(pa.int64())
        columns[name] = whole.cast(schema.field(name).type)
    for each in differences(entry):
        # Nine digits: 0.3, not 0.30000000000000004, for 0.8 less 0.5.
        both = (columns[each[part]].cast(pa.float64()) for part in ("of", "less"))
        columns[each["name"]] = pc.round(pc.subtract(*both), 9)
    return pa.table(list(columns.values()), schema=schema).unify_dictionaries()


def plain(table: pa.Table) -> pa.Table:
    """Return a table without dictionaries, for formats and functions that know none."""
    fields = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in table.schema]
    return table.cast(pa.schema(fields, metadata=table.schema.metadata))


def repeated(text: str, count: int) -> Any:
    """Return a column of texts that are all this one."""
    return pa.repeat(text, count).dictionary_encode() if count else pa.array([], KIND)


# ---- tables that say what happened in a flight: events, faults, summary, steps, points, and the flight itself


def record_column(entry: Record) -> pa.Field:
    """Return a column of a record, as fields.json describes it."""
    type_, about = TYPES[entry["type"]], (entry.get("help") or entry.get("title") or "", entry.get("unit") or "")
    return column(entry["name"], type_, "text" if type_ in (KIND, pa.string()) else "value", *about)


def columns_of(fields: Record, name: str) -> pa.Schema:
    """Return the columns of a table: as the plugin's fields.json describes them, or those of this package."""
    if name in OWN:
        return pa.schema(map(record_column, OWN[name]))
    described = fields["statistics"][name]["columns"]
    if name == "events":  # a fault is an event, too
        described = [*described, *fields["statistics"]["faults"]["columns"]]
    found = list({each["name"]: record_column(each) for each in described if each["type"] in TYPES}.values())
    if name != "buses":
        behind = [each.name for each in found].index("source") + 1
        found[behind:behind] = map(record_column, OWN["controller"])
    return pa.schema(found if name == "faults" else [*found, *map(record_column, OWN["other"])])


def table(records: Iterable[Record], columns: pa.Schema) -> pa.Table:
    """Return JSON lines of a statistic as a table; keys without a column come as JSON in `other`."""
    rows = []
    for record in records:
        row = {each.name: _cell(each.type, record.get(each.name)) for each in columns}
        if "controller" in row:
            row["controller"] = record.get("source")
        more = {key: value for key, value in record.items() if key not in {*row, "values"} and value is not None}
        if "other" in row and more:
            row["other"] = json.dumps(more, ensure_ascii=False, default=float)
        rows.append(row)
    return pa.Table.from_pylist(rows, columns)


def _cell(type_: pa.DataType, value: Any) -> Any:
    if value is None:
        return None
    if type_ == TIME:
        return int(Decimal(value).scaleb(9))
    if type_ in (KIND, pa.string()):
        return str(value)
    return float(value) if isinstance(value, Decimal) else value


def to_write(name: str, rows: pa.Table, flight: Record) -> pa.Table:
    """Return records with flight_id and source_file, and `message_name`: `message` would be taken for the folder's."""
    names = ["message_name" if each == "message" else each for each in rows.schema.names]
    about = {"title": name.title(), "schema": str(SCHEMA)}
    rows = rows.rename_columns(names).unify_dictionaries().replace_schema_metadata(about)
    for at, key in enumerate(("flight_id", "source_file")):
        head = column(key, KIND, "text")
        rows = rows.add_column(at, head, repeated(flight[key], len(rows)))
    return rows
