# SPDX-License-Identifier: GPL-2.0-or-later
"""Tables that say what happened in a flight: events, faults, summary, statistics, and the flight itself."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa

from .bench import aligned
from .errors import count_of
from .incidents import faults_in
from .runs import samples
from .steps import POINTS, STEPS, point_columns, points, steps
from .tables import KIND, TIME, Column, Message, Origin, Rows, Table, present, repeated
from .tshark import Export, Record

# A step of the capture's clock, in seconds, that counts as "it was set".
SET = 1.0
# Nobody recorded before 2000: an earlier time counts from the recorder's own start. Nanoseconds since 1970.
YEAR_2000 = 946_684_800_000_000_000
# Every table's first columns, of which `table` knows nothing.
HEAD = {"flight_id": KIND, "source_file": KIND}
# The types of fields.json's statistics. What has another type is an object or a list: it goes into `other`.
TYPES = {"time": TIME, "id": pa.uint32(), "integer": pa.int64(), "number": pa.float64(), "seconds": pa.float64()}
TYPES |= {"boolean": pa.bool_(), "string": KIND, "text": pa.string()}
CONTROLLER = "controller", "string", "the same name: all messages of a controller have it", ""
OTHER = "other", "text", "what the plugin says besides, as JSON: keys that have no column of their own", ""
# Tables of this package: name, type, meaning, unit. The plugin describes events, faults and summary.
STATISTICS = (
    ("field", "string", "the field", ""),
    ("min", "number", "its smallest value, in the unit of the message's column", ""),
    ("mean", "number", "its mean", ""),
    ("max", "number", "its largest value", ""),
)
FLIGHTS = (
    ("capture", "text", "the path of the capture, when it was converted", ""),
    ("start", "time", "the first message, UTC; null where the capture tells no absolute time", ""),
    ("length", "number", "from the first message to the last; without steps of the clock", "s"),
    ("is_absolute", "boolean", "whether the capture tells the date; if not, times count from 1970", ""),
    ("clock_resets", "integer", "how often the capture's clock was set: events `clock` of more than a second", ""),
    ("aircraft", "string", "its name in the fleet file", ""),
    ("plugin", "string", "the version of the plugin", ""),
    ("tools", "string", "the version of yapp-tables", ""),
    ("options", "string", "the preferences", ""),
    ("messages", "integer", "rows of all messages", ""),
    ("faults", "integer", "incidents with a fault; events of a controller at most 2 s apart are one incident", ""),
    ("partial", "text", "why the capture was read only in part", ""),
    ("undecoded", "text", "which messages were not decoded", ""),
    ("left_out", "text", "what else is missing, and what to know of the times and of copies", ""),
)
TABLES = ("events", "faults", "summary", "statistics", "steps", "points", "flights")


class Records(Table):
    """A table of records. rows: what makes it, once it is wanted."""

    def __init__(self, name: str, rows: Callable[[], pa.Table], origin: Origin, columns: Mapping[str, Column]) -> None:
        """Add flight_id and source_file; a column `message` would be taken for the folder's: it is `message_name`."""
        self.rows, self.origin = rows, origin
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


def column(name: str, type_: str, meaning: str, unit: str = "") -> Column:
    """Return a column of a record; type_: a word of TYPES."""
    return Column(name, TYPES[type_], _role(TYPES[type_]), meaning, unit)


def columns_of(fields: Record, name: str) -> dict[str, Column]:
    """Return the columns of a table: as the plugin's fields.json describes them, or those of this package."""
    own = {"flights": FLIGHTS, "steps": STEPS, "points": POINTS}
    if name in own:
        found = [column(*each) for each in own[name]]
    else:
        of = fields["statistics"]
        described = of["summary" if name == "statistics" else name]["columns"]
        if name == "events":  # a fault is an event, too
            described = {each["name"]: each for each in (*described, *of["faults"]["columns"])}.values()
        found = [
            column(each["name"], each["type"], each.get("help") or each.get("title") or "", each.get("unit") or "")
            for each in described
            if each["type"] in TYPES
        ]
        names = [each.name for each in found]
        found.insert(names.index("source") + 1, column(*CONTROLLER))
        if name == "statistics":
            who = ("bus", "id", "source", "controller", "message")
            found = [each for each in found if each.name in who] + [column(*each) for each in STATISTICS]
        elif name != "faults":
            found.append(column(*OTHER))
    return {each.name: each for each in found}


def table(records: Sequence[Record], columns: Mapping[str, Column]) -> pa.Table:
    """JSON lines of a statistic as a table; keys without a column come as JSON in `other`."""
    schema = pa.schema([(name, each.type) for name, each in columns.items()])
    return pa.Table.from_pylist([_cells(record, columns) for record in records], schema)


# Keys that another column or table has.
ELSEWHERE = {"values"}


def _cells(record: Record, columns: Mapping[str, Column]) -> Record:
    cells = {name: _cell(each.type, record.get(name)) for name, each in columns.items()}
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


def faults(events: pa.Table, columns: Mapping[str, Column]) -> pa.Table:
    """Return the flags that were raised and cleared, of all events."""
    is_fault = [kind == "fault" for kind in events["kind"].to_pylist()]
    return events.filter(pa.array(is_fault, pa.bool_())).select(
        [name for name in columns if name in events.schema.names]
    )


def statistics(summary: Sequence[Record], columns: Mapping[str, Column]) -> pa.Table:
    """The summary's `values`: a row for each source and field."""
    rows = [
        record | {"field": name} | values for record in summary for name, values in (record.get("values") or {}).items()
    ]
    return table(rows, columns)


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


def all_tables(export: Export, origin: Origin, log: Path | None = None) -> list[Table]:
    """Return the messages of an export, and its events, faults, summary, statistics and the flight itself.

    log: of a thrust stand. Raises SetupError where that does not fit.
    """
    rows = [Rows(export, message, origin) for message in present(export)]
    columns = {name: columns_of(export.fields, name) for name in TABLES}
    columns["faults"] = {name: each for name, each in columns["faults"].items() if name in columns["events"]}
    events = table(export.records["events"], columns["events"])
    following = _following(export, origin)
    start = min((int(each["time"][0].value) for each in following.values()), default=0)
    found = samples(following, start=start)
    bench = aligned(log, found) if log else None
    extra = point_columns(found, list(bench.columns) if bench else [])
    columns["points"] |= {each[0]: column(*each) for each in extra}
    if bench:
        export.said.append(bench.said)
    makers: dict[str, Callable[[], pa.Table]] = {
        "events": lambda: events,
        "faults": lambda: faults(events, columns["faults"]),
        "summary": lambda: table(export.records["summary"], columns["summary"]),
        "statistics": lambda: statistics(export.records["summary"], columns["statistics"]),
        "steps": lambda: _timed(steps(found), columns["steps"], start),
        "points": lambda: _timed(points(found, vars(bench) if bench else None), columns["points"], start),
        # Asked last: the times are known then.
        "flights": lambda: _flight(export, origin, rows, events),
    }
    return [*rows, *(Records(name, make, origin, columns[name]) for name, make in makers.items())]


def _following(export: Export, origin: Origin) -> dict[str, pa.Table]:
    """Return the messages that steps and points are made of: that with a speed and its command, and those commands."""
    catalogue = present(export)
    tied = {name.removesuffix("_commanded"): each for each in catalogue for name in each.columns
            if name.endswith("_commanded")}  # fmt: skip
    if not tied:
        return {}
    wanted = [each for each in catalogue if each in tied.values() or tied.keys() & each.columns.keys()]
    tables = {}
    for message in wanted:
        names = ["frame", "bus", "id", "source", *(name for name, each in message.columns.items()
                 if each.role in ("value", "clock"))]  # fmt: skip
        rows = Rows(export, message, origin, names)
        tables[message.name] = pa.Table.from_batches(rows, rows.schema).unify_dictionaries()
    return tables


def _timed(rows: Iterable[Record], columns: Mapping[str, Column], start: int) -> pa.Table:
    return table([row | {"time": Decimal(start + round(row.pop("at") * 1e9)).scaleb(-9)} for row in rows], columns)


def _flight(export: Export, origin: Origin, rows: Sequence[Rows], events: pa.Table) -> pa.Table:
    ends = sorted(end for each in rows for end in each.ends)
    steps = [float(row["length"] or 0) for row in export.records["events"] if row["kind"] == "clock"]
    steps = [step for step in steps if abs(step) > SET]
    length = (ends[-1][1] - ends[0][1]) / 1e9 - sum(steps)
    start, last = ends[0][1], ends[-1][1]
    if start < YEAR_2000 <= last:  # the recorder got the time after a while
        start = last - round(length * 1e9)
    is_absolute = start >= YEAR_2000
    said = [*export.complaints, *export.notes, *export.said]
    if steps:
        times = count_of(len(steps), "time")
        said.append(f"the capture's clock was set {times}: times before and after do not compare")
    if not is_absolute:
        said.append("the capture tells no absolute time: times count from 1970")
    about = {"capture": str(origin.capture), "start": start if is_absolute else None, "length": length}
    about |= {"is_absolute": is_absolute, "clock_resets": len(steps)}
    about |= {"aircraft": origin.aircraft, "plugin": export.fields["plugin"], "tools": version("yapp-tables")}
    about |= {"options": " ".join(origin.tshark.options), "messages": sum(each.count for each in rows)}
    about |= {"faults": faults_in(events), "partial": export.partial}
    about |= {"undecoded": export.undecoded or None, "left_out": "; ".join(said) or None}
    schema = pa.schema([(each.name, each.type) for each in columns_of({}, "flights").values()])
    return pa.Table.from_pylist([about], schema)
