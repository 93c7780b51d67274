#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Print docs/columns.md: every column of every table, from the code and the catalogue: columns_page.py >docs/columns.md"""
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "src"))  # that of this tree, installed or not
from yapp_tables import Tshark
from yapp_tables.steps import point_columns
from yapp_tables.tables import (
    DURATION, HEAD, KIND, OWN, SCHEMA, TABLES, TIME, columns_of, differences, messages, record_column, said,
)

NAMES = {TIME: "time", DURATION: "duration", KIND: "text"}
ABOUT = {
    "events": """\
What happened, in the order of time. An event belongs to one message ID: if a controller that sends
Motor Data and Health reboots or falls silent, these are two events. To count controllers, take one
`message_name`.""",
    "faults": """\
The events of kind `fault`: a row when a flag is raised, and one when it is cleared or the flight
ends. The sum of `active` is how long a flag was set.""",
    "summary": """\
A row for each bus and ID. Good messages have a good CRC, or need none. If a source counts by Seq
No, a damaged message is `missing`, too, and the lost share is `missing / (count + missing)`.
Otherwise it is `(crc_bad + incomplete) / (count + crc_bad + incomplete)`.""",
    "buses": """\
A row for each CAN bus, if `convert` got its `--bitrate`. `other` has the error frames by kind.""",
    "steps": """\
A row for each change of a command by 5 % of its range or more, if the command held for 0.5 s. Times
are by the controller's clock, on lines between two messages. `resolution` is their distance.""",
    "points": """\
A row for each hold of a command of 3 s or more: means after its first second, and how fast
temperatures rose. `convert --with bench.csv` adds the means of a thrust stand's log as
`bench_<column>`. A catalogue of your own has its own fields in A, V, W, RPM and °C here.""",
    "flights": "A row for each flight.",
}
HEADING = f"""\
# Every column of every table

Made by `tools/columns_page.py`. How to use the tables: [tables.md](tables.md).

This is version {SCHEMA} of the data set: `schema` in the metadata of every Parquet file and Delta table.
What is absent is null. A reserved value is null, too; `<field>_special` has its name.

| type here | Parquet, notebook | Delta | CSV | MF4 | MCAP |
|---|---|---|---|---|---|
| time | timestamp(ns, UTC) | timestamp(us, UTC); `time_ns` has nanoseconds | UTC, nine digits | the time axis | the log time, else text |
| duration | duration(ns) | int64, nanoseconds | seconds, nine digits | seconds | seconds |
| text | dictionary of strings | string | text | text | text |
| string | string | string | text | text | text |
| uint8, uint16, uint32 | the same | int16, int32, int64 | number | the same | integer |
| uint64 | the same | decimal(20, 0) | number | the same | integer |

duckdb and Spark show a duration of Parquet as an integer of nanoseconds. duckdb cannot subtract
times with nanoseconds: take `epoch_ns(time)`. In SQL a null equals nothing: where `bus` may be
null, join by `IS NOT DISTINCT FROM`.
"""


def table(rows):
    """Lines of a table."""
    lines = ["| column | type | unit | meaning |", "|---|---|---|---|"]
    return "\n".join(lines + [f"| {' | '.join(row)} |" for row in rows])


def name_of(type_):
    """How the page names a type."""
    return NAMES.get(type_) or {"double": "float64"}.get(str(type_), str(type_))


def meaning(column, names, less):
    """What a field is."""
    name, about = column.name, said(column.metadata)
    if name in less:
        return f"{about['title']}: `{less[name]['of']}` less `{less[name]['less']}`"
    if name.endswith("_special") and name.removesuffix("_special") in names:
        return "the reserved value: `nan`, `inf`, `-inf`, `above`, `below`"
    if name.endswith("_text") and name.removesuffix("_text") in names:
        return f"the meaning of `{name.removesuffix('_text')}`"
    values = ", ".join(f"{number} {text}" for number, text in json.loads(about.get("values", "{}")).items())
    return f"{about['title']}: {values}" if values and len(values) < 80 else about["title"]


def unit(column):
    """The unit of a column; a duration has its own."""
    return "" if column.type == DURATION else said(column.metadata).get("unit", "")


print(HEADING)
print("## Every message\n")
print(table((f"`{each['name']}`", name_of(HEAD[each["name"]]), "", each["help"]) for each in OWN["head"]))
fields = Tshark(plugin=str(Path(__file__).parents[1] / "yapp.lua")).fields()
for name, schema in messages(fields).items():
    print(f"\n## {name}: {said(schema.metadata)['title']}\n\nThe columns of every message, then:\n")
    less = {each["name"]: each for each in differences(fields["messages"][name])}
    own = [column for column in schema if column.name not in HEAD]
    print(table((f"`{c.name}`", name_of(c.type), unit(c), meaning(c, schema.names, less)) for c in own))
for name in TABLES:
    columns = columns_of(fields, name)
    if name == "points":
        columns = [*columns, *map(record_column, point_columns(messages(fields)))]
    print(f"\n## {name}\n\n{ABOUT[name]}\nThe first columns are `flight_id` and `source_file`, then:\n")
    names = {"message": "message_name"}
    print(table((f"`{names.get(c.name, c.name)}`", name_of(c.type), unit(c), said(c.metadata)["title"]) for c in columns))
print("\nIn a notebook, `message_name` is called `message`: `flight.events` and the others have no folder.")
