# SPDX-License-Identifier: GPL-2.0-or-later
"""Types: what fields.json and the plugin's CSV say, as Arrow schemas and streams of typed record batches."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv

from .errors import SetupError
from .tshark import Export, Record, Tshark, left_out

# The version of a data set, `schema` in the metadata of each table: raised when a column gets another name, type or
# meaning.
SCHEMA = 5
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
# Arrow reads up to 32 blocks ahead.
BLOCK_BYTES = 1 << 20


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
    columns = {name: _columns(name, entry) for name, entry in fields["messages"].items()}
    found = {}
    for name, entry in fields["messages"].items():
        own = {column.name: column for column in columns[name]}
        found[name] = Message(name, entry["title"] or name, entry.get("every"), own)
    return found


def digests(fields: Record) -> dict[str, str]:
    """Return a short name of each message's description."""
    texts = {name: json.dumps(entry, sort_keys=True) for name, entry in fields["messages"].items()}
    return {name: hashlib.sha256(text.encode()).hexdigest()[:16] for name, text in texts.items()}


def catalogue_version(fields: Record) -> str:
    """Return the messages of the catalogue, and a short name of what it says of all of them."""
    whole = hashlib.sha256(json.dumps(digests(fields), sort_keys=True).encode()).hexdigest()[:8]
    return f"{', '.join(fields['messages'])} ({whole})"


def _columns(message: str, entry: Record) -> list[Column]:
    given = {each["name"]: each for each in entry["columns"] if each["name"] not in HEAD and each["name"] != CRC_GOOD}
    columns = [_column(each, given) for each in given.values()]
    is_number = {column.name: column.role == "value" for column in columns}
    for each in entry.get("differences") or ():
        name, parts = each["name"], (each["of"], each["less"])
        if all(is_number.get(part) for part in parts) and name not in given:
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
    """Where tables come from. flight_id: of the capture's content; aircraft: its name in the fleet file."""

    flight_id: str
    capture: Path
    aircraft: str | None = None
    tshark: Tshark = field(default_factory=Tshark)


class Table:
    """Rows to write. columns: what is known of them; count: how many rows came of the latest iteration."""

    def __init__(self, message: Message, schema: pa.Schema, columns: list[Column]) -> None:
        """Keep the description."""
        about = (schema.metadata or {}) | {b"schema": str(SCHEMA).encode()}
        self.message, self.schema, self.columns = message, schema.with_metadata(about), columns
        self.name, self.count = message.name, 0

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Read the rows once more from their beginning."""
        raise NotImplementedError


class Rows(Table):
    """The rows of one message in an export: their schema, and typed record batches, a few megabytes at a time.

    ends: (frame, nanoseconds) of the first and the last row that were read.
    """

    def __init__(self, export: Export, message: Message, origin: Origin, wanted: Sequence[str] | None = None) -> None:
        """wanted: the columns to read besides the time, None for all."""
        self.origin, self.export = origin, export
        self.ends: list[tuple[int, int]] = []
        self._path = export.csv(message.name)
        with self._path.open(encoding="utf-8", newline="") as file:
            self._header = next(csv.reader(file), [])
        strange = set(self._header) - message.columns.keys() - HEAD.keys() - {CRC_GOOD}
        if strange or "time" not in self._header:
            raise SetupError(
                f"{self._path.name} has columns that the plugin's fields.json does not tell: {strange or 'none'}"
            )
        head_names = [name for name in HEAD if wanted is None or name in wanted or name == "time"]
        columns = [column for name, column in message.columns.items() if wanted is None or name in wanted]
        about = {"message": message.name, "title": message.title, "every": str(message.every or "")}
        head = [pa.field(name, HEAD[name]) for name in head_names]
        schema = pa.schema(head + [column.arrow() for column in columns], metadata=about)
        super().__init__(message, schema, columns)

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Read the file once more from its beginning."""
        self.count, self.ends = 0, []
        for batch in self._read():
            if batch.num_rows:
                given = dict(zip(batch.schema.names, batch.columns, strict=True))
                given["time"] = _nanoseconds(given["time"]).cast(TIME)
                last = batch.num_rows - 1
                times = given["time"].cast(pa.int64())
                ends = [(given["frame"][at].as_py(), times[at].as_py()) for at in (0, last)]
                self.ends = [*self.ends[:1], ends[-1]] if self.ends else ends
                yield self._typed(given, batch.num_rows)
                self.count += batch.num_rows

    def first_time(self) -> int:
        """The first row's time in nanoseconds since 1970."""
        first: pa.RecordBatch = next(iter(self))
        return int(first.column("time")[0].value)

    def _read(self) -> Iterator[pa.RecordBatch]:
        wanted = {*self.schema.names, "time", "frame"}
        for column in self.columns:
            wanted |= set(column.difference or ())
        if "controller" in wanted:
            wanted.add("source")
        types = {column.name: column.type for column in self.message.columns.values()} | HEAD
        types = {name: pa.string() if type_ in (TIME, DURATION) else type_ for name, type_ in types.items()}
        return read_csv(self._path, [name for name in self._header if name in wanted], types)

    def _typed(self, given: dict[str, pa.Array], count: int) -> pa.RecordBatch:
        given["source_file"] = repeated(self.origin.capture.name, count)
        given["flight_id"] = repeated(self.origin.flight_id, count)
        given["controller"] = given.get("source")
        for column in self.columns:
            if column.difference:
                # Nine digits: 0.3, not 0.30000000000000004, for 0.8 less 0.5.
                of, less = (given[name].cast(pa.float64()) for name in column.difference)
                given[column.name] = pc.round(pc.subtract(of, less), 9)
            elif column.type == DURATION and column.name in given:
                given[column.name] = _nanoseconds(given[column.name]).cast(DURATION)
        columns = [
            pa.nulls(count, field.type) if given.get(field.name) is None else given[field.name] for field in self.schema
        ]
        return pa.RecordBatch.from_arrays(columns, schema=self.schema)


def read_csv(path: Path, names: Sequence[str], types: Mapping[str, pa.DataType]) -> Iterator[pa.RecordBatch]:
    """Read these columns of a table of the plugin, a block at a time. An empty cell is null."""
    has_text = any(types[name] == pa.string() and name != "time" for name in names)
    reader: Iterator[pa.RecordBatch] = arrow_csv.open_csv(
        path,
        # One thread: a fleet has a capture for every core.
        read_options=arrow_csv.ReadOptions(use_threads=False, block_size=BLOCK_BYTES),
        parse_options=arrow_csv.ParseOptions(newlines_in_values=has_text),
        convert_options=arrow_csv.ConvertOptions(
            column_types={name: types[name] for name in names},
            include_columns=names,
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=False,
        ),
    )
    return reader


def _nanoseconds(seconds: pa.Array | pa.ChunkedArray) -> Any:
    """Seconds as text with nine digits are nanoseconds once the point is gone."""
    return pc.replace_substring(seconds, ".", "").cast(pa.int64())


def present(export: Export) -> list[Message]:
    """The messages that the export has rows of, in the catalogue's order."""
    return [message for message in messages(export.fields).values() if has_rows(export.csv(message.name))]


def nothing_in(capture: Path, export: Export, filter_: str | None = None) -> str:
    """Return why a capture gives no table."""
    narrowed = f" that {filter_} lets through" if filter_ else ""
    why = "; ".join(left_out(export.partial, export.undecoded, export.complaints))
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
