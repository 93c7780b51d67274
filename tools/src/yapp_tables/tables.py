# SPDX-License-Identifier: GPL-2.0-or-later
"""Types: what fields.json and the plugin's CSV say, as Arrow schemas and streams of typed record batches."""

from __future__ import annotations

import csv
import hashlib
import json
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pyarrow import csv as arrow_csv

from .errors import SetupError
from .tshark import Export, Record, Tshark
from .undecoded import left_out

TIME = pa.timestamp("ns", tz="UTC")
# Every message's first columns.  The CSV has no source_file, the capture's name, and no flight_id.
HEAD = {
    "time": TIME,
    "source_file": pa.string(),
    "bus": pa.string(),
    "frame": pa.int64(),
    "source": pa.string(),
    "id": pa.uint32(),
    "seq": pa.uint8(),
    "flight_id": pa.string(),
}
# The types of fields.json that need no second look, and their roles.  A time is the controller's own, in seconds.
ROLES = {
    "float": (pa.float64(), "value"),
    "time": (pa.float64(), "clock"),
    "bool": (pa.bool_(), "flag"),
    "string": (pa.string(), "text"),
}
CRC_GOOD = "crc_good"
# The reserved counts that are numbers; `above` and `below` the range are none.
SPECIAL = ("nan", "inf", "-inf")
# Arrow reads up to 32 blocks ahead.
BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class Column:
    """A column of the CSV: its type, and what Parquet, MF4 and the report tell about it.

    role: "value", "clock", "enum", "flags", "flag" or "text" (also an enum's meaning, a reserved count's name).
    """

    name: str
    type: pa.DataType
    role: str
    title: str = ""
    unit: str = ""
    filter: str = ""
    values: dict[int, str] = field(default_factory=dict)

    def arrow(self) -> pa.Field:
        """The Arrow field; its metadata name title, unit, display filter and the meanings of an enum's numbers."""
        about = {"title": self.title, "unit": self.unit, "filter": self.filter}
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
    return {name: _message(name, entry) for name, entry in fields["messages"].items()}


def digests(fields: Record) -> dict[str, str]:
    """Return a short name of each message's description."""
    texts = {name: json.dumps(entry, sort_keys=True) for name, entry in fields["messages"].items()}
    return {name: hashlib.sha256(text.encode()).hexdigest()[:16] for name, text in texts.items()}


def catalogue_version(fields: Record) -> str:
    """Return the messages of the catalogue, and a short name of what it says of all of them."""
    whole = hashlib.sha256(json.dumps(digests(fields), sort_keys=True).encode()).hexdigest()[:8]
    return f"{', '.join(fields['messages'])} ({whole})"


def _message(name: str, entry: Record) -> Message:
    own = [column for column in entry["columns"] if column["name"] not in HEAD and column["name"] != CRC_GOOD]
    return Message(
        name, entry["title"] or name, entry.get("every"), {column["name"]: _column(column) for column in own}
    )


def _column(entry: Record) -> Column:
    name, kind = entry["name"], entry["type"]
    about = {"title": entry.get("title") or name, "unit": entry.get("unit") or "", "filter": entry.get("filter") or ""}
    if kind in ROLES:
        type_, role = ROLES[kind]
        return Column(name, type_, role, **about)
    if entry.get("values") is not None:
        values = {int(number): text for number, text in entry["values"].items()}
        return Column(name, _integer(entry), "enum", values=values, **about)
    if entry["kind"] == "flags":
        return Column(name, _integer(entry), "flags", **about)
    return Column(name, _integer(entry), "value", **about)


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
        self.message, self.schema, self.columns = message, schema, columns
        self.name, self.count = message.name, 0

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Read the rows once more from their beginning."""
        raise NotImplementedError


class Records(Table):
    """A table of events, faults, the summary or the flight itself. rows: what makes it, once it is wanted."""

    def __init__(self, name: str, rows: Callable[[], pa.Table], origin: Origin, schema: pa.Schema) -> None:
        """Add flight_id and source_file; a column `message` would be taken for the folder's: it is `message_name`."""
        self.rows, self.origin = rows, origin
        names = ["message_name" if each == "message" else each for each in schema.names]
        fields = [pa.field(each, type_) for each, type_ in zip(names, schema.types, strict=True)]
        head = [pa.field(each, pa.string()) for each in ("flight_id", "source_file")]
        columns = [Column(each.name, each.type, _role(each.type)) for each in (*head, *fields)]
        super().__init__(Message(name, name.title(), None, {}), pa.schema(head + fields), columns)

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Return all rows at once: they are few."""
        rows = self.rows()
        self.count = len(rows)
        same = [[text] * len(rows) for text in (self.origin.flight_id, self.origin.capture.name)]
        yield from pa.table([*same, *rows.columns], schema=self.schema).combine_chunks().to_batches()


def _role(type_: pa.DataType) -> str:
    return "text" if pa.types.is_string(type_) else "value"


class Rows(Table):
    """The rows of one message in an export: their schema, and typed record batches, a few megabytes at a time.

    span: the first and the last time in the batches that were read, in nanoseconds since 1970.
    """

    def __init__(self, export: Export, message: Message, origin: Origin, wanted: Sequence[str] | None = None) -> None:
        """wanted: the columns to read besides the time, None for all."""
        self.origin, self.wanted = origin, wanted
        self.span: tuple[int, int] | None = None
        self._path = export.csv(message.name)
        with self._path.open(encoding="utf-8", newline="") as file:
            self._header = next(csv.reader(file), [])
        strange = set(self._header) - message.columns.keys() - HEAD.keys() - {CRC_GOOD}
        head_names = [name for name in HEAD if wanted is None or name in wanted or name == "time"]
        if strange or "time" not in self._header:
            raise SetupError(
                f"{self._path.name} has columns that the plugin's fields.json does not tell: {strange or 'none'}"
            )
        given = [name for name in self._header if name in message.columns]
        columns = [message.columns[name] for name in given if wanted is None or name in wanted]
        about = {"message": message.name, "title": message.title, "every": str(message.every or "")}
        head = [pa.field(name, HEAD[name]) for name in head_names]
        schema = pa.schema(head + [column.arrow() for column in columns], metadata=about)
        super().__init__(message, schema, columns)

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Read the file once more from its beginning."""
        self.count = 0
        special = [f"{name}_special" for name in self.schema.names]
        included = [name for name in self._header if name in self.schema.names or name in special]
        types = {column.name: column.type for column in self.columns} | {
            name: t for name, t in HEAD.items() if t != TIME
        }
        reader = arrow_csv.open_csv(
            self._path,
            # One thread: a fleet has a capture for every core.
            read_options=arrow_csv.ReadOptions(use_threads=False, block_size=BLOCK_BYTES),
            parse_options=arrow_csv.ParseOptions(newlines_in_values=any(c.role == "text" for c in self.columns)),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types | {"time": pa.string()},
                include_columns=included,
                null_values=[""],
                strings_can_be_null=True,
                quoted_strings_can_be_null=False,
            ),
        )
        for batch in reader:
            if batch.num_rows:
                typed = self._typed(batch)
                self.count += len(typed)
                times = pc.min_max(typed.column("time").cast(pa.int64()))
                low, high = times["min"].as_py(), times["max"].as_py()
                self.span = min(low, (self.span or (low,))[0]), max(high, (self.span or (high,))[-1])
                yield typed

    def first_time(self) -> int:
        """The first row's time in nanoseconds since 1970."""
        first: pa.RecordBatch = next(iter(self))
        return int(first.column("time")[0].value)

    def _typed(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        given = dict(zip(batch.schema.names, batch.columns, strict=True))
        given["time"] = _nanoseconds(given["time"])
        given["source_file"] = _repeated(self.origin.capture.name, batch.num_rows)
        given["flight_id"] = _repeated(self.origin.flight_id, batch.num_rows)
        for column in self.columns:
            special = given.get(f"{column.name}_special")
            if special is not None and special.null_count < len(special):
                given[column.name] = _with_special(given[column.name], special)
        absent = (name for name in HEAD if name not in given)
        given |= {name: pa.nulls(batch.num_rows, HEAD[name]) for name in absent}
        return pa.RecordBatch.from_arrays([given[name] for name in self.schema.names], schema=self.schema)


def _nanoseconds(seconds: pa.Array) -> pa.Array:
    """Seconds as text with nine digits are nanoseconds once the point is gone."""
    return pc.replace_substring(seconds, ".", "").cast(pa.int64()).cast(TIME)


# From here to `present` no Python value becomes Arrow's by pa.scalar or pa.array: these import pandas where it is
# installed, and that takes as long as to write a flight of half an hour.
def _repeated(text: str, count: int) -> pa.Array:
    """A column of strings that are all this one, which is not empty."""
    data = text.encode()
    offsets = array("i", range(0, (count + 1) * len(data), len(data)))
    return pa.StringArray.from_buffers(count, pa.py_buffer(offsets), pa.py_buffer(data * count))


def _with_special(values: pa.Array, special: pa.Array) -> pa.Array:
    for name in SPECIAL:
        names = _repeated(name, 1)
        number = names.cast(pa.float64())[0]
        values = pc.if_else(pc.is_in(special, value_set=names), number, values)
    return values


def present(export: Export) -> list[Message]:
    """The messages that the export has rows of, in the catalogue's order."""
    return [message for message in messages(export.fields).values() if _has_rows(export.csv(message.name))]


def nothing_in(capture: Path, export: Export, filter_: str | None = None) -> str:
    """Return why a capture gives no table."""
    narrowed = f" that {filter_} lets through" if filter_ else ""
    why = "; ".join(left_out(export.partial, export.undecoded, export.complaints))
    return f"{capture}: no YAPP messages in it{narrowed}{': ' * bool(why)}{why}"


def _has_rows(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return len(list(zip(range(2), file, strict=False))) == 2


def _schema(columns: str) -> pa.Schema:
    """Return a schema of "name:type" words; a name alone is text."""
    pairs = (word.partition(":") for word in columns.split())
    return pa.schema([(name, TIME if kind == "time" else getattr(pa, kind or "string")()) for name, _, kind in pairs])


EVENTS = _schema(
    "time:time kind frame:int64 bus id:uint32 source message field flag event active:float64 "
    "length:float64 what value size:int64 count:int64 like help"
)
FAULT = ("time", "frame", "bus", "id", "source", "message", "field", "flag", "event", "active", "help")
SUMMARY = _schema(
    "bus id:uint32 source message count:int64 rate:float64 gap_min:float64 gap_mean:float64 "
    "gap_max:float64 gap_max_frame:int64 crc_bad:int64 incomplete:int64 late:int64 reboots:int64 "
    "invalid:int64 skipped:int64"
)
STATISTICS = _schema("bus id:uint32 source message field min:float64 mean:float64 max:float64")
FLIGHTS = _schema(
    "capture start:time length:float64 aircraft plugin tools options messages:int64 faults:int64 partial "
    "undecoded left_out"
)


def faults(events: pa.Table) -> pa.Table:
    """Return the flags that were raised and cleared, of all events."""
    columns = [name for name in FAULT if name in events.schema.names]
    return events.filter(pc.equal(events["kind"], "fault")).select(columns)


def all_tables(export: Export, origin: Origin) -> list[Table]:
    """Return the messages of an export, and its events, faults, summary and the flight itself."""
    rows = [Rows(export, message, origin) for message in present(export)]
    events = table(export.records["events"], EVENTS)

    def flight() -> pa.Table:
        """Asked last: the times are known then."""
        spans = [each.span for each in rows if each.span]
        start, end = min(span[0] for span in spans), max(span[1] for span in spans)
        about = {"capture": str(origin.capture), "start": start, "length": (end - start) / 1e9}
        about |= {"aircraft": origin.aircraft, "plugin": export.fields["plugin"], "tools": version("yapp-tables")}
        about |= {"options": " ".join(origin.tshark.options), "messages": sum(each.count for each in rows)}
        about |= {"faults": pc.sum(pc.equal(events["event"], "raised")).as_py() or 0, "partial": export.partial}
        about |= {"undecoded": export.undecoded or None, "left_out": "; ".join(export.complaints) or None}
        return pa.Table.from_pylist([about], FLIGHTS)

    parts = {
        "events": (lambda: events, EVENTS),
        "faults": (lambda: faults(events), faults(EVENTS.empty_table()).schema),
    }
    parts |= {"summary": (lambda: table(export.records["summary"], SUMMARY), SUMMARY), "flights": (flight, FLIGHTS)}
    return [*rows, *(Records(name, make, origin, schema) for name, (make, schema) in parts.items())]


def table(records: list[Record], schema: pa.Schema) -> pa.Table:
    """JSON lines of a statistic as a table; keys that the schema does not name are left out."""
    return pa.Table.from_pylist(
        [{key: _cell(key, record.get(key)) for key in schema.names} for record in records], schema
    )


def _cell(key: str, value: Any) -> Any:
    if isinstance(value, Decimal):
        return int(value.scaleb(9)) if key == "time" else float(value)
    if key == "value" and value is not None:
        return str(value)
    return value * 10**9 if key == "time" and isinstance(value, int) else value


def statistics(summary: list[Record]) -> pa.Table:
    """The summary's `values`: a row for each source and field."""
    rows = [
        record | {"field": name} | values for record in summary for name, values in (record.get("values") or {}).items()
    ]
    return table(rows, STATISTICS)
