# SPDX-License-Identifier: GPL-2.0-or-later
"""The pictures of a page: panels of values, bars of states, small pictures of each controller, what did not change."""

from __future__ import annotations

import base64
import gzip
import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .differs import differing
from .series import Array, Source, numbers, sources, spans, thin
from .tables import Column, Message

# What the page keeps of a signal of one source; the page itself thins that to what its window has room for.
SAMPLES = 100_000
MARKS = SPANS = 2_000
# A panel has no more fields than there are dashes to tell them apart.
FIELDS = 6
# Shades of one source from another's: (bus, ID) of a controller, not its place in a list, says its colour.
COLOURS, IDS_OF_A_BUS = 16, 8
Record = dict[str, Any]


class Pictures:
    """What report.js draws, as JSON.

    sources: {name, label, colour, flight} of each; times: the x axes that traces share; small: [{source, title, unit,
    x, command, measured}]; panels: [{unit, message, fields, traces, marks}]; bars: [{title, message, kind, rows}];
    differs: who is different from the others.
    """

    def __init__(self, start: int) -> None:
        """start: nanoseconds since 1970."""
        self.start = start
        self.sources: list[Record] = []
        self.times: list[Record] = []
        self.panels: list[Record] = []
        self.bars: list[Record] = []
        self.small: list[Record] = []
        self.differs: list[Record] = []
        self.bytes = bytearray()
        self.flight = 0

    def add(self, message: Message, table: pa.Table, alarms: set[str], prefix: str = "") -> None:
        """Draw a message.  alarms: the flags of it that were faults, each by its column; prefix: of sources' names."""
        found = list(sources(table, message.every, self.start))
        whose = [self.source(prefix + source.name, first_of(source)) for source in found]
        self.differs += [row | {"source": prefix + row["source"]} for row in differing(message, found, alarms)]
        known = (column for column in message.columns.values() if column.name in table.schema.names)
        columns = [column for column in known if column.role in ("value", "enum", "flag")]
        fields = [column for column in columns if column.role == "value"]
        values = {column.name: [numbers(source.rows[column.name]) for source in found] for column in columns}
        marks = {column.name: [_marks(source, column) for source in found] for column in fields}
        drawn = [each for each in fields if any(map(_varies, values[each.name])) or _partly(each, values, marks)]
        self._lines(message, found, whose, drawn, values, marks)
        for column in columns:
            if column.role != "value":
                self._bars(message, found, whose, column, values[column.name], column.name in alarms)

    def source(self, name: str, row: Record) -> int:
        """Return the number of a source."""
        known = [source["name"] for source in self.sources]
        number = known.index(name) if name in known else len(known)
        if number == len(known):
            bus = row.get("bus") or ""
            label = f"{name} ({bus})" if bus and not name.rpartition(": ")[2].startswith(bus) else name
            self.sources.append(
                {"name": name, "label": label, "colour": _colour(bus, row.get("id")), "flight": self.flight}
            )
        return number

    def blob(self) -> str:
        """Return all samples, packed."""
        return packed(bytes(self.bytes))

    def _lines(
        self,
        message: Message,
        found: list[Source],
        whose: list[int],
        drawn: list[Column],
        values: dict[str, list[Array]],
        marks: dict[str, list[Record | None]],
    ) -> None:
        """The values of all sources: a panel for each unit, times once, marks where there was a reserved count."""
        places = self._places(message, drawn)
        for number, source in enumerate(found if drawn else ()):
            times, lines = thin(source, [values[column.name][number] for column in drawn], SAMPLES)
            self.times.append(self._keep(np.diff(np.round(times * 1e6), prepend=0), "<i4"))
            stored = {}
            for column, (panel, place), line in zip(drawn, places, lines, strict=True):
                stored[column.name] = self._keep(line, "<f4")
                trace = {"source": whose[number], "field": place, "x": len(self.times) - 1}
                panel["traces"].append(trace | {"y": stored[column.name]})
                if mark := marks[column.name][number]:
                    panel["marks"].append({"source": whose[number], "field": place} | mark)
            for column in drawn:
                command = column.name.replace("_measured", "_commanded")
                if command != column.name and command in stored:
                    about = {"source": whose[number], "title": column.title, "unit": column.unit}
                    about |= {"x": len(self.times) - 1, "measured": stored[column.name], "command": stored[command]}
                    self.small.append(about)

    def _keep(self, values: Array, kind: str) -> Record:
        """Keep samples, all first bytes, then all second ones: so they pack well."""
        data = np.frombuffer(values.astype(kind).tobytes(), np.uint8).reshape(-1, 4).T.tobytes()
        self.bytes += data
        return {"at": len(self.bytes) - len(data), "count": len(values)}

    def _places(self, message: Message, drawn: list[Column]) -> list[tuple[Record, int]]:
        """The panel of each field, and its place there."""
        panels: dict[str, Record] = {}
        places = []
        for column in drawn:
            if column.unit not in panels or len(panels[column.unit]["fields"]) == FIELDS:
                panels[column.unit] = {"unit": column.unit, "message": message.title}
                panels[column.unit] |= {"fields": [], "traces": [], "marks": [], "every": message.every}
                self.panels.append(panels[column.unit])
            panels[column.unit]["fields"].append(column.title)
            places.append((panels[column.unit], len(panels[column.unit]["fields"]) - 1))
        return places

    def _bars(
        self,
        message: Message,
        found: list[Source],
        whose: list[int],
        column: Column,
        values: list[Array],
        is_alarm: bool,
    ) -> None:
        """What an enum said when, or when a flag was set."""
        is_flag = column.role == "flag"
        if is_flag and not any(np.nanmax(each, initial=0) for each in values):
            return
        rows = []
        for source, who, each in zip(found, whose, values, strict=True):
            held = [span for span in spans(source, each, SPANS) if span[2] == span[2] and (span[2] or not is_flag)]
            texts = [] if is_flag else [_text(column, value) for _, _, value in held]
            row = {
                "source": who,
                "texts": texts,
                "begins": [each[0] for each in held],
                "ends": [each[1] for each in held],
            }
            rows += [row] if held else []
        kind = "fault" if is_alarm else column.role
        self.bars.append({"title": column.title, "message": message.title, "kind": kind, "rows": rows})


def packed(data: bytes) -> str:
    """Return bytes as gzip in base64, the same each time."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()


def first_of(source: Source) -> Record:
    """Return bus and ID of a source."""
    return {"bus": source.rows["bus"][0].as_py(), "id": source.rows["id"][0].as_py()}


def _colour(bus: str, number: int | None) -> int:
    """Return the same colour for the same controller in every flight: by the end of its ID, and its bus's number."""
    found = re.search(r"\d+$", bus)
    return ((number or 0) % IDS_OF_A_BUS + IDS_OF_A_BUS * int(found[0] if found else 0)) % COLOURS


def _varies(values: Array) -> bool:
    """Whether it has two values; absent ones are none."""
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and bool((finite != finite[0]).any())


def _partly(column: Column, values: dict[str, list[Array]], marks: dict[str, list[Record | None]]) -> bool:
    """Whether a level line has marks in it."""
    pairs = zip(values[column.name], marks[column.name], strict=True)
    return any(mark is not None and bool(np.isfinite(each).any()) for each, mark in pairs)


def _text(column: Column, value: float) -> str:
    """What an enum's number means."""
    return column.values.get(int(value)) or f"{int(value):#x}, not defined"


def _marks(source: Source, column: Column) -> Record | None:
    """When a reserved count stood in the place of a value, and which; not where it is so all the time."""
    name = f"{column.name}_special"
    if name not in source.rows.schema.names:
        return None
    special = source.rows[name]
    at = np.flatnonzero(special.is_valid().to_numpy())
    if len(at) == len(special) and pc.count_distinct(special).as_py() == 1:
        at = at[:1]
    at = at[:: -(-len(at) // MARKS) or 1]
    if not len(at):
        return None
    return {"x": source.times[at].tolist(), "what": special.take(pa.array(at)).to_pylist()}
