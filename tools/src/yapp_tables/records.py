# SPDX-License-Identifier: GPL-2.0-or-later
"""Tables that say what happened in a flight: events, faults, summary, statistics, and the flight itself."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from importlib.metadata import version
from typing import Any

import pyarrow as pa

from .clock import clock_of
from .errors import count_of
from .scalars import mask, repeated, table_of
from .tables import KIND, TIME, Column, Message, Origin, Rows, Table, present
from .tshark import Export, Record

# Events of one controller that are no further apart than this, in seconds, are one incident.
TOGETHER = 2.0
INCIDENT = ("fault", "reboot", "silence", "stale")
# Every table's first columns, of which `table` knows nothing.
HEAD = {"flight_id": KIND, "source_file": KIND}
WHO = """
bus         kind    the bus or line; null where the capture names none
id          uint32  the message ID; null where the event is of the whole capture
source      kind    the name that `yapp.sources` gives to the ID; null without a name
controller  kind    the same name: all messages of a controller have it
message     kind    the message's name in the catalogue; null if the catalogue has none
"""


def _columns(text: str) -> dict[str, Column]:
    """Return columns of lines "name type meaning"; a meaning may begin with a unit, "[s] of both"."""
    types = {"time": TIME, "kind": KIND}
    found = {}
    for line in text.strip().splitlines():
        name, type_, meaning = line.split(maxsplit=2)
        unit, _, rest = meaning[1:].partition("] ") if meaning.startswith("[") else ("", "", meaning)
        kind = types.get(type_) or getattr(pa, type_)()
        role = "text" if kind in (KIND, pa.string()) else "value"
        found[name] = Column(name, kind, role, rest, unit)
    return found


OTHER = "other       string  what the plugin says besides, as JSON: keys that have no column of their own"
EVENTS = _columns(f"""
time        time    when it happened, UTC; null where nothing came
kind        kind    what happened: `fault`, `reboot`, `silence` and others, see statistics.md
frame       int64   the packet that shows it
{WHO.strip()}
field       kind    the flags or the enum concerned
flag        kind    of a fault: the flag
event       kind    of a fault: `raised`, `cleared`, or `active` at the end
active      float64 [s] of a fault: how long it was there; null for `raised`
length      float64 [s] of a silence, a jump or a step of the clock; of `skipped`: bytes
what        kind    of `incomplete`: what was wrong with it
value       string  of `invalid`: what the field had
size        int64   of `unknown`: bytes of each message
count       int64   how many messages or packets; null for one
like        kind    of `unknown`: the message that has this size
help        kind    what the catalogue says of the flag
{OTHER}
""")
FAULT = ("time", "frame", "bus", "id", "source", "controller", "message", "field", "flag", "event", "active", "help")
FAULTS = {name: EVENTS[name] for name in FAULT}
# A newer column of the plugin is not listed here: columns_of adds it, as fields.json describes it.
SUMMARY = _columns(f"""
{WHO.strip()}
count         int64   good messages
rate          float64 [Hz] (count - 1) / (last - first)
gap_min       float64 [s] the shortest time between two messages
gap_mean      float64 [s] the mean
gap_max       float64 [s] the longest
gap_max_frame int64   the message behind the longest gap
crc_bad       int64   messages with a bad CRC
incomplete    int64   messages without their beginning, with bytes missing, truncated or unfinished
late          int64   silences between two messages
reboots       int64   how often the controller's clock went back
invalid       int64   messages with a value that the catalogue does not define
skipped       int64   stretches of bytes in a stream that belong to no frame
missing       int64   messages missing by Seq No
copies        int64   messages that were recorded a second time
{OTHER}
""")
STATISTICS = _columns(f"""
{WHO.strip()}
field       kind    the field
min         float64 its smallest value, in the unit of the message's column
mean        float64 its mean
max         float64 its largest value
""")
FLIGHTS = _columns("""
capture      string  the path of the capture, when it was converted
start        time    the first message, UTC; null where the capture tells no absolute time
length       float64 [s] from the first message to the last; without steps of the clock
is_absolute  bool_   whether the capture tells the date; if not, times count from 1970
clock_resets int64   how often the capture's clock was set: back by over 1 s, or on by over a day
aircraft     kind    its name in the fleet file
plugin       string  the version of the plugin
tools        string  the version of yapp-tables
options      string  the preferences
messages     int64   rows of all messages
faults       int64   incidents with a fault; events of a controller at most 2 s apart are one incident
partial      string  why the capture was read only in part
undecoded    string  which messages were not decoded
left_out     string  what else is missing, and what to know of the times and of copies
""")


class Records(Table):
    """A table of records. rows: what makes it, once it is wanted."""

    def __init__(
        self, name: str, rows: Callable[[], pa.Table], origin: Origin, columns: Mapping[str, Column] | None = None
    ) -> None:
        """Add flight_id and source_file; a column `message` would be taken for the folder's: it is `message_name`."""
        self.rows, self.origin = rows, origin
        columns = TABLES[name] if columns is None else columns
        names = {"message": "message_name"}
        fields = [
            pa.field(names.get(each.name, each.name), each.type, metadata=_about(each)) for each in columns.values()
        ]
        head = [pa.field(each, type_) for each, type_ in HEAD.items()]
        known = [Column(each.name, each.type, _role(each.type)) for each in (*head, *fields)]
        super().__init__(Message(name, name.title(), None, {}), pa.schema(head + fields), known)

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        """Return all rows at once: they are few."""
        rows = self.rows()
        self.count = len(rows)
        head = [repeated(text, len(rows)) for text in (self.origin.flight_id, self.origin.capture.name)]
        columns = [*head, *rows.unify_dictionaries().columns]
        yield from pa.table(columns, schema=self.schema).combine_chunks().to_batches()


def _about(column: Column) -> dict[str, str]:
    about = {"title": column.title, "unit": column.unit}
    return {key: text for key, text in about.items() if text}


def _role(type_: pa.DataType) -> str:
    return "text" if type_ in (KIND, pa.string()) else "value"


# The types of fields.json's statistics. What has another type is an object or a list: it goes into `other`.
TYPES = {
    "time": TIME,
    "id": pa.uint32(),
    "integer": pa.int64(),
    "number": pa.float64(),
    "seconds": pa.float64(),
    "boolean": pa.bool_(),
    "string": KIND,
    "text": pa.string(),
}
TABLES: dict[str, dict[str, Column]] = {
    "events": EVENTS,
    "faults": FAULTS,
    "summary": SUMMARY,
    "statistics": STATISTICS,
    "flights": FLIGHTS,
}


def columns_of(fields: Record, name: str) -> dict[str, Column]:
    """Return the columns of a statistic: those of this package, then what the plugin's fields.json has besides."""
    known = dict(TABLES[name])
    other = {"other": known.pop("other")} if "other" in known else {}
    described = fields.get("statistics", {}).get(name, {}).get("columns", [])
    new = [each for each in described if each["name"] not in known and each["type"] in TYPES]
    return known | {each["name"]: _described(each) for each in new} | other


def _described(entry: Record) -> Column:
    type_ = TYPES[entry["type"]]
    about = entry.get("help") or entry.get("title") or entry["name"]
    return Column(entry["name"], type_, _role(type_), about, entry.get("unit") or "")


def table(records: Sequence[Record], columns: Mapping[str, Column]) -> pa.Table:
    """JSON lines of a statistic as a table; keys without a column come as JSON in `other`."""
    return table_of(
        [_cells(record, columns) for record in records], {name: each.type for name, each in columns.items()}
    )


# Keys that another column or table has.
ELSEWHERE = {"values"}


def _cells(record: Record, columns: Mapping[str, Column]) -> Record:
    cells = {name: _cell(column.type, record.get(name)) for name, column in columns.items()}
    if "controller" in columns:
        cells["controller"] = record.get("source")
    more = {key: value for key, value in record.items() if key not in columns.keys() | ELSEWHERE and value is not None}
    if "other" in columns and more:
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


def faults(events: pa.Table, columns: Mapping[str, Column] = FAULTS) -> pa.Table:
    """Return the flags that were raised and cleared, of all events."""
    is_fault = [kind == "fault" for kind in events["kind"].to_pylist()]
    names = [name for name in columns if name in events.schema.names]
    return events.filter(mask(is_fault)).select(names)


def statistics(summary: Sequence[Record]) -> pa.Table:
    """The summary's `values`: a row for each source and field."""
    rows = [
        record | {"field": name} | values for record in summary for name, values in (record.get("values") or {}).items()
    ]
    return table(rows, STATISTICS)


def controllers(events: Sequence[Record]) -> list[object]:
    """Return the controller of each event, None where it has no ID.

    It is a name; without one that of the same bus and last digit of the ID, if it has one; else these two.
    """
    places = [None if event["id"] is None else (event["bus"], event["id"] & 0xF) for event in events]
    names = {place: event["controller"] for place, event in zip(places, events, strict=True) if event["controller"]}
    return [event["controller"] or names.get(place, place) for place, event in zip(places, events, strict=True)]


def incidents(events: pa.Table) -> int:
    """Return how many incidents of the events have a fault."""
    spans: dict[object, list[tuple[float, float, bool]]] = {}
    open_: dict[object, tuple[object, float]] = {}
    at = events["time"].cast(pa.int64()).to_pylist()
    last = max((time for time in at if time is not None), default=0) / 1e9
    rows: list[Record] = events.drop_columns(["time"]).to_pylist()
    for time, event, who in zip(at, rows, controllers(rows), strict=True):
        if event["kind"] not in INCIDENT or time is None:
            continue
        begin = time / 1e9
        key = (event["bus"], event["id"], event["source"], event["message"], event["field"], event["flag"])
        if event["kind"] != "fault":
            spans.setdefault(who, []).append((begin, begin + (event["length"] or 0.0), False))
        elif event["event"] == "raised":
            open_[key] = who, begin
        elif key in open_:
            who, begin = open_.pop(key)
            spans.setdefault(who, []).append((begin, time / 1e9, True))
        elif event["event"] == "cleared":  # raised before what was let through
            spans.setdefault(who, []).append((time / 1e9, time / 1e9, True))
    for who, begin in open_.values():
        spans.setdefault(who, []).append((begin, last, True))
    return sum(_with_fault(sorted(own)) for own in spans.values())


def _with_fault(spans: Sequence[tuple[float, float, bool]]) -> int:
    found: list[bool] = []
    until = -1e300
    for begin, end, is_fault in spans:
        if begin > until + TOGETHER:
            found.append(False)
            until = end
        found[-1], until = found[-1] or is_fault, max(until, end)
    return sum(found)


def name_hint(summary: pa.Table) -> str:
    """Return how to name the controllers of a flight in which none has a name; empty where one has, or one is alone."""
    rows = [row for row in summary.to_pylist() if row["id"] is not None and row["message"]]
    if len(rows) < 2 or any(row["source"] for row in rows):
        return ""
    found: dict[tuple[str | None, int], list[str]] = {}
    for row in rows:
        found.setdefault((row["bus"], row["id"] & 0xF), []).append(f"0x{row['id']:03x}")
    parts = []
    for number, ((bus, _), ids) in enumerate(found.items(), 1):
        quoted = bus if bus is None or re.fullmatch(r"[A-Za-z][\w#-]*", bus) else f'"{bus}"'
        parts.append(f"{quoted}/{'+'.join(ids)}=esc{number}" if bus else f"{'+'.join(ids)}=esc{number}")
    names = ", ".join(parts)
    return f"no controller has a name, so the column controller is empty: set yapp.sources, as in yapp.sources:{names}"


def all_tables(export: Export, origin: Origin) -> list[Table]:
    """Return the messages of an export, and its events, faults, summary, statistics and the flight itself."""
    rows = [Rows(export, message, origin) for message in present(export)]
    columns = {name: columns_of(export.fields, name) for name in TABLES}
    columns["faults"] = {name: each for name, each in columns["faults"].items() if name in columns["events"]}
    events = table(export.records["events"], columns["events"])
    makers: dict[str, Callable[[], pa.Table]] = {
        "events": lambda: events,
        "faults": lambda: faults(events, columns["faults"]),
        "summary": lambda: table(export.records["summary"], columns["summary"]),
        "statistics": lambda: statistics(export.records["summary"]),
        # Asked last: the times are known then.
        "flights": lambda: _flight(export, origin, rows, events),
    }
    return [*rows, *(Records(name, make, origin, columns[name]) for name, make in makers.items())]


def _flight(export: Export, origin: Origin, rows: Sequence[Rows], events: pa.Table) -> pa.Table:
    clock = clock_of(each.stretches for each in rows)
    said = [*export.complaints, *export.notes]
    if clock.resets:
        times = count_of(clock.resets, "time")
        said.append(f"the capture's clock was set {times}: times before and after do not compare")
    if clock.start is None:
        said.append("the capture tells no absolute time: times count from 1970")
    about = {"capture": str(origin.capture), "start": clock.start, "length": clock.length / 1e9}
    about |= {"is_absolute": clock.start is not None, "clock_resets": clock.resets}
    about |= {"aircraft": origin.aircraft, "plugin": export.fields["plugin"], "tools": version("yapp-tables")}
    about |= {"options": " ".join(origin.tshark.options), "messages": sum(each.count for each in rows)}
    about |= {"faults": incidents(events), "partial": export.partial}
    about |= {"undecoded": export.undecoded or None, "left_out": "; ".join(said) or None}
    return table_of([about], {name: column.type for name, column in FLIGHTS.items()})
