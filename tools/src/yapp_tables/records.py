# SPDX-License-Identifier: GPL-2.0-or-later
"""Tables that say what happened in a flight: events, faults, summary, steps, points, and the flight itself."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from .bench import aligned
from .errors import count_of
from .incidents import faults_in
from .series import samples
from .steps import POINTS, STEPS, point_columns, points, steps
from .tables import KIND, SCHEMA, TIME, Column, Message, Origin, Table, present, read_rows, repeated
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


def record_table(name: str, rows: pa.Table, origin: Origin, columns: Mapping[str, Column]) -> Table:
    """Return records to write, with flight_id and source_file.

    A column `message` would be taken for the folder's: it is `message_name`.
    """
    names = {"message": "message_name"}
    known = [Column(each, type_, _role(type_)) for each, type_ in HEAD.items()]
    known += [replace(each, name=names.get(each.name, each.name)) for each in columns.values()]
    cells = [repeated(text, len(rows)) for text in (origin.flight_id, origin.capture.name)]
    schema = pa.schema([each.arrow() for each in known], metadata={"schema": str(SCHEMA)})
    whole = pa.table([*cells, *rows.unify_dictionaries().columns], schema=schema)
    return Table(Message(name, name.title(), None, {}), whole, known, is_message=False)


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
        described = of[name]["columns"]
        if name == "events":  # a fault is an event, too
            described = {each["name"]: each for each in (*described, *of["faults"]["columns"])}.values()
        found = [
            column(each["name"], each["type"], each.get("help") or each.get("title") or "", each.get("unit") or "")
            for each in described
            if each["type"] in TYPES
        ]
        names = [each.name for each in found]
        found.insert(names.index("source") + 1, column(*CONTROLLER))
        if name != "faults":
            found.append(column(*OTHER))
    return {each.name: each for each in found}


def table(records: Sequence[Record], columns: Mapping[str, Column]) -> pa.Table:
    """JSON lines of a statistic as a table; keys without a column come as JSON in `other`."""
    schema = pa.schema([(name, each.type) for name, each in columns.items()])
    return pa.Table.from_pylist([_cells(record, columns) for record in records], schema)


def _cells(record: Record, columns: Mapping[str, Column]) -> Record:
    cells = {name: _cell(each.type, record.get(name)) for name, each in columns.items()}
    if "controller" in columns:
        cells["controller"] = record.get("source")
    more = {key: value for key, value in record.items() if key not in columns.keys() | {"values"} and value is not None}
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
    is_fault = pc.equal(events["kind"].cast(pa.string()), "fault")
    return events.filter(is_fault).select([name for name in columns if name in events.schema.names])


def all_tables(export: Export, origin: Origin, log: Path | None = None) -> list[Table]:
    """Return the messages of an export, and its events, faults, summary, steps, points and the flight itself.

    log: of a thrust stand. Raises SetupError where that does not fit.
    """
    messages = [read_rows(export, message, origin) for message in present(export)]
    columns = {name: columns_of(export.fields, name) for name in TABLES}
    columns["faults"] = {name: each for name, each in columns["faults"].items() if name in columns["events"]}
    events = table(export.records["events"], columns["events"])
    # Steps and points are made of the message with a speed and its command, and of those commands.
    tied = {name.removesuffix("_commanded"): each for each in messages for name in each.message.columns
            if name.endswith("_commanded")}  # fmt: skip
    following = {
        each.name: each.rows for each in messages if each in tied.values() or tied.keys() & each.message.columns
    }
    start = min((pc.min(each["time"]).value for each in following.values()), default=0)
    found = samples(following, start=start)
    bench = aligned(log, found) if log else None
    extra = point_columns(found, list(bench.columns) if bench else [])
    columns["points"] |= {each[0]: column(*each) for each in extra}
    if bench:
        export.said.append(bench.said)
    records = {
        "events": events,
        "faults": faults(events, columns["faults"]),
        "summary": table(export.records["summary"], columns["summary"]),
        "steps": _timed(steps(found), columns["steps"], start),
        "points": _timed(points(found, vars(bench) if bench else None), columns["points"], start),
        "flights": _flight(export, origin, messages, events),
    }
    return [*messages, *(record_table(name, rows, origin, columns[name]) for name, rows in records.items())]


def _timed(rows: Iterable[Record], columns: Mapping[str, Column], start: int) -> pa.Table:
    return table([row | {"time": Decimal(start + round(row.pop("at") * 1e9)).scaleb(-9)} for row in rows], columns)


def _flight(export: Export, origin: Origin, messages: Sequence[Table], events: pa.Table) -> pa.Table:
    ends = sorted((each.rows["frame"][at].as_py(), each.rows["time"][at].value) for each in messages for at in (0, -1))
    steps = [float(row["length"] or 0) for row in export.records["events"] if row["kind"] == "clock"]
    steps = [step for step in steps if abs(step) > SET]
    length = (ends[-1][1] - ends[0][1]) / 1e9 - sum(steps)
    start, last = ends[0][1], ends[-1][1]
    if start < YEAR_2000 <= last:  # the recorder got the time after a while
        start = last - round(length * 1e9)
    is_absolute = start >= YEAR_2000
    said = [*export.lacks, *export.notes, *export.said]
    if steps:
        times = count_of(len(steps), "time")
        said.append(f"the capture's clock was set {times}: times before and after do not compare")
    if not is_absolute:
        said.append("the capture tells no absolute time: times count from 1970")
    about = {"capture": str(origin.capture), "start": start if is_absolute else None, "length": length}
    about |= {"is_absolute": is_absolute, "clock_resets": len(steps)}
    about |= {"plugin": export.fields["plugin"], "tools": version("yapp-tables"), "options": " ".join(origin.options)}
    about |= {"messages": sum(len(each.rows) for each in messages), "faults": faults_in(events)}
    about |= {"partial": export.partial, "left_out": "; ".join(said) or None}
    schema = pa.schema([(each.name, each.type) for each in columns_of({}, "flights").values()])
    return pa.Table.from_pylist([about], schema)
