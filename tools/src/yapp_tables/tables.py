# SPDX-License-Identifier: GPL-2.0-or-later
"""Types: what fields.json and the plugin's CSV say, as Arrow schemas and tables."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv

from .errors import SetupError
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
CRC_GOOD = "crc_good"


@dataclass(frozen=True)
class Column:
    """A column of a table: its type, and what Parquet, MF4 and the report tell about it.

    role: "value", "clock", "enum", "flags", "flag" or "text" (also an enum's meaning, a reserved value's name);
    difference: the two columns whose difference it is.
    """

    name: str
    type: pa.DataType
    role: str
    title: str = ""
    unit: str = ""
    filter: str = ""
    values: dict[int, str] = field(default_factory=dict)
    difference: tuple[str, str] | None = None

    def arrow(self) -> pa.Field:
        """The Arrow field; its metadata name title, unit, display filter and the meanings of an enum's numbers."""
        unit = "ns" if self.type == DURATION else self.unit
        about = {"title": self.title, "unit": unit, "filter": self.filter, "role": self.role}
        if self.values:
            about["values"] = json.dumps(self.values, ensure_ascii=False)
        return pa.field(self.name, self.type, metadata={key: text for key, text in about.items() if text})


@dataclass(frozen=True)
class Message:
    """A message of the catalogue as fields.json describes it. every: its period in seconds, where it has one."""

    name: str
    title: str
    every: float | None
    columns: dict[str, Column]


def messages(fields: Record) -> dict[str, Message]:
    """The catalogue in fields.json, by message name."""
    return {
        name: Message(
            name, entry["title"] or name, entry.get("every"), {one.name: one for one in _columns(name, entry)}
        )
        for name, entry in fields["messages"].items()
    }


def catalogue_version(fields: Record) -> str:
    """Return the messages of the catalogue, and a short name of what it says of all of them."""
    text = json.dumps(fields["messages"], sort_keys=True)
    return f"{', '.join(fields['messages'])} ({hashlib.sha256(text.encode()).hexdigest()[:8]})"


def _columns(message: str, entry: Record) -> list[Column]:
    given = {each["name"]: each for each in entry["columns"] if each["name"] not in HEAD and each["name"] != CRC_GOOD}
    columns = [_column(each, given) for each in given.values()]
    is_number = {column.name: column.role == "value" for column in columns}
    for each in entry.get("formulas") or ():
        name, parts = each["name"], (each["of"], each["less"])
        if each["operator"] == "-" and all(is_number.get(part) for part in parts) and name not in given:
            about = {"title": each["title"], "unit": each["unit"] or "", "filter": f"taurus.{message}.{name}"}
            columns.append(Column(name, pa.float64(), "value", difference=parts, **about))
    return columns


def _column(entry: Record, given: Mapping[str, Record]) -> Column:
    name, kind = entry["name"], entry["type"]
    about = {"title": entry.get("title") or name, "unit": entry.get("unit") or "", "filter": entry.get("filter") or ""}
    if kind in ROLES:
        type_, role = ROLES[kind]
        is_kind = kind == "string" and name.removesuffix("_text").removesuffix("_special") in given.keys() - {name}
        return Column(name, KIND if is_kind else type_, role, **about)
    if entry.get("values") is not None:
        values = {int(number): text for number, text in entry["values"].items()}
        return Column(name, _integer(entry), "enum", values=values, **about)
    return Column(name, _integer(entry), "flags" if entry["kind"] == "flags" else "value", **about)


def _integer(entry: Record) -> pa.DataType:
    """The integer type that the field fits in."""
    sign = "" if entry["kind"] == "int" else "u"
    return getattr(pa, f"{sign}int{next(size for size in (8, 16, 32, 64) if size >= entry['bits'])}")()


@dataclass(frozen=True)
class Origin:
    """Where tables come from. flight_id: of the capture's content; options: with which it was decoded."""

    flight_id: str
    capture: Path
    options: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table to write. columns: what is known of them; is_message: whether its rows are of sources."""

    message: Message
    rows: pa.Table
    columns: list[Column]
    is_message: bool = True

    @property
    def name(self) -> str:
        """The name of the message."""
        return self.message.name


def read_rows(export: Export, message: Message, origin: Origin, wanted: Sequence[str] | None = None) -> Table:
    """Return the rows of one message in an export. wanted: the columns besides the time, None for all."""
    path = export.csv(message.name)
    with path.open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file), [])
    strange = set(header) - message.columns.keys() - HEAD.keys() - {CRC_GOOD}
    if strange or "time" not in header:
        raise SetupError(f"{path.name} has columns that the plugin's fields.json does not tell: {strange or 'none'}")
    columns = [column for name, column in message.columns.items() if wanted is None or name in wanted]
    about = {"message": message.name, "title": message.title, "every": str(message.every or ""), "schema": str(SCHEMA)}
    head = [pa.field(name, HEAD[name]) for name in HEAD if wanted is None or name in (*wanted, "time")]
    schema = pa.schema(head + [column.arrow() for column in columns], metadata=about)
    needed = {*schema.names, "time", *(name for column in columns for name in column.difference or ())}
    needed |= {"source"} & {"source" for name in schema.names if name == "controller"}
    found = _read_csv(path, [name for name in header if name in needed], message)
    given = dict(zip(found.schema.names, found.columns, strict=True))
    given |= {"time": _nanoseconds(given["time"]).cast(TIME), "controller": given.get("source")}
    given |= {"source_file": repeated(origin.capture.name, len(found))}
    given |= {"flight_id": repeated(origin.flight_id, len(found))}
    for column in columns:
        if column.difference:
            # Nine digits: 0.3, not 0.30000000000000004, for 0.8 less 0.5.
            of, less = (given[name].cast(pa.float64()) for name in column.difference)
            given[column.name] = pc.round(pc.subtract(of, less), 9)
        elif column.type == DURATION and column.name in given:
            given[column.name] = _nanoseconds(given[column.name]).cast(DURATION)
    cells = [
        pa.nulls(len(found), field.type) if given.get(field.name) is None else given[field.name] for field in schema
    ]
    return Table(message, pa.table(cells, schema=schema).unify_dictionaries(), columns)


def _read_csv(path: Path, names: Sequence[str], message: Message) -> pa.Table:
    """Read these columns of a table of the plugin. An empty cell is null."""
    types = {column.name: column.type for column in message.columns.values()} | HEAD
    types = {name: pa.string() if type_ in (TIME, DURATION) else type_ for name, type_ in types.items()}
    has_text = any(types[name] == pa.string() and name != "time" for name in names)
    return arrow_csv.read_csv(
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


def _nanoseconds(seconds: pa.ChunkedArray) -> Any:
    """Seconds as text with nine digits are nanoseconds once the point is gone."""
    return pc.replace_substring(seconds, ".", "").cast(pa.int64())


def present(export: Export) -> list[Message]:
    """The messages that the export has rows of, in the catalogue's order."""
    return [message for message in messages(export.fields).values() if has_rows(export.csv(message.name))]


def nothing_in(capture: Path, export: Export, filter_: str | None = None) -> str:
    """Return why a capture gives no table."""
    narrowed = f" that {filter_} lets through" if filter_ else ""
    why = "; ".join(export.left_out)
    return f"{capture}: no YAPP messages in it{narrowed}{': ' * bool(why)}{why}"


def has_rows(path: Path) -> bool:
    """Return whether a table of the plugin is there and has more than its header."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return len(list(zip(range(2), file, strict=False))) == 2


def plain(table: pa.Table) -> pa.Table:
    """Return a table without dictionaries, for formats and functions that know none."""
    fields = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in table.schema]
    return table.cast(pa.schema(fields, metadata=table.schema.metadata))


def repeated(text: str, count: int) -> pa.Array:
    """Return a column of texts that are all this one."""
    return pa.repeat(text, count).dictionary_encode() if count else pa.array([], KIND)
