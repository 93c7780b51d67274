# SPDX-License-Identifier: GPL-2.0-or-later
"""The pictures of a page: panels of values with their spread, bars of states, and what did not change."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from .series import Array, Source, Spread, numbers, sources, spans, spread, thin
from .tables import Column, Message

# What the page keeps of a signal of one source; the page itself thins that to what its window has room for.
SAMPLES = 100_000
MARKS = SPANS = 2_000
# A panel has no more fields than there are dashes to tell them apart.
FIELDS = 6
Record = dict[str, Any]


@dataclass
class _Field:
    """A field as all sources of its message have it; spread: None where there is one source."""

    column: Column
    values: list[Array]
    marks: list[Record | None]
    spread: Spread | None

    @classmethod
    def of(cls, column: Column, found: list[Source]) -> _Field:
        values = [numbers(source.rows[column.name]) for source in found]
        marks = [_marks(source, column) for source in found]
        return cls(column, values, marks, spread(found, values) if len(found) > 1 else None)

    def is_worth_it(self) -> bool:
        """Whether a panel would show something: a line that is not level, or one with marks in it."""
        return any(
            _varies(values) or (marks is not None and bool(np.isfinite(values).any()))
            for values, marks in zip(self.values, self.marks, strict=True)
        )

    def constants(self) -> list[str]:
        """What the sources say all the time: a number, the names of reserved counts, or nothing."""
        texts = []
        for values, marks in zip(self.values, self.marks, strict=True):
            finite = values[np.isfinite(values)]
            texts.append(f"{finite[0]:.7g}" if len(finite) else ", ".join(sorted(set(marks["what"]))) if marks else "")
        return texts


class Pictures:
    """What report.js draws, as JSON.

    sources: names, a colour each; legend: [{messages, sources}]; times: the x axes that traces share;
    panels: [{unit, message, fields, traces, marks, spread}]; bars: [{title, message, kind, rows}]; values: a table for
    each message; constants: [{message, field, value}].
    """

    def __init__(self, start: int) -> None:
        """start: nanoseconds since 1970."""
        self.start = start
        self.sources: list[str] = []
        self.times: list[str] = []
        self.panels: list[Record] = []
        self.bars: list[Record] = []
        self.values: list[Record] = []
        self.constants: list[Record] = []
        self._messages: dict[str, list[str]] = {}

    def add(self, message: Message, table: pa.Table, alarms: set[str]) -> None:
        """Draw a message.  alarms: the flags of it that were faults, each by its column."""
        found = list(sources(table, message.every, self.start))
        for source in found:
            self.source(source.name, message.title)
        columns = [column for column in message.columns.values() if column.name in table.schema.names]
        fields = [_Field.of(column, found) for column in columns if column.role == "value"]
        self._lines(message, found, [field for field in fields if field.is_worth_it()])
        self._table(message, found, fields)
        for field in fields:
            if not field.is_worth_it():
                self._constant(message, field.column, field.constants(), found)
        for column in columns:
            if column.role in ("enum", "flag"):
                self._bars(message, found, column, column.name in alarms)

    def source(self, name: str, message: str) -> int:
        """The number of a source, which is its colour."""
        titles = self._messages.setdefault(name, [])
        if message not in titles:
            titles.append(message)
        if name not in self.sources:
            self.sources.append(name)
        return self.sources.index(name)

    def legend(self) -> list[Record]:
        """Which sources there are, together those of the same messages."""
        groups: dict[str, list[int]] = {}
        for name, titles in self._messages.items():
            groups.setdefault(", ".join(titles), []).append(self.sources.index(name))
        return [{"messages": titles, "sources": members} for titles, members in groups.items()]

    def _lines(self, message: Message, found: list[Source], drawn: list[_Field]) -> None:
        """The values of all sources: a panel for each unit, times once, marks where there was a reserved count."""
        places = self._places(message, drawn)
        for number, source in enumerate(found):
            who = self.sources.index(source.name)
            x, lines = self._thin(source, [field.values[number] for field in drawn])
            for field, (panel, place), line in zip(drawn, places, lines, strict=True):
                panel["traces"].append({"source": who, "field": place, "x": x, "y": line})
                if marks := field.marks[number]:
                    panel["marks"].append({"source": who, "field": place} | marks)
        spreads = [field.spread for field in drawn if field.spread]
        if spreads:
            x, lines = self._thin(
                Source("", found[0].rows, spreads[0].times, found[0].every), [each.values for each in spreads]
            )
            for each, (panel, place), line in zip(spreads, places, lines, strict=True):
                if np.nanmax(each.values, initial=0) > 0:
                    panel["spread"].append({"field": place, "x": x, "y": line})

    def _table(self, message: Message, found: list[Source], fields: list[_Field]) -> None:
        """Minimum, mean and maximum of each source, and the largest spread between them."""
        names = [source.name for source in found]
        rows = [
            {"field": field.column.title, "unit": field.column.unit, "ranges": [_range(each) for each in field.values]}
            | (field.spread.largest(names) if field.spread else {})
            for field in fields
        ]
        if rows:
            self.values.append({"message": message.title, "sources": names, "rows": rows})

    def _thin(self, source: Source, lines: list[Array]) -> tuple[int, list[str]]:
        """Thinned and packed: the place of the times, which the lines share, and the lines."""
        if not lines:
            return -1, []
        times, thinned = thin(source, lines, SAMPLES)
        self.times.append(_packed(times, "<f8"))
        return len(self.times) - 1, [_packed(line, "<f4") for line in thinned]

    def _places(self, message: Message, drawn: list[_Field]) -> list[tuple[Record, int]]:
        """The panel of each field, and its place there."""
        panels: dict[str, Record] = {}
        places = []
        for field in drawn:
            unit = field.column.unit
            if unit not in panels or len(panels[unit]["fields"]) == FIELDS:
                panels[unit] = {"unit": unit, "message": message.title}
                panels[unit] |= {"fields": [], "traces": [], "marks": [], "spread": []}
                self.panels.append(panels[unit])
            panels[unit]["fields"].append(field.column.title)
            places.append((panels[unit], len(panels[unit]["fields"]) - 1))
        return places

    def _bars(self, message: Message, found: list[Source], column: Column, is_alarm: bool) -> None:
        """What an enum said when, or when a flag was set; a line of its own where none of that changed."""
        values = [numbers(source.rows[column.name]) for source in found]
        is_flag = column.role == "flag"
        if is_flag and not any(np.nanmax(each, initial=0) for each in values):
            return
        if not is_alarm and not any(map(_varies, values)):
            self._constant(message, column, [_meaning(column, each) for each in values], found)
            return
        bars = {"title": column.title, "message": message.title, "kind": "fault" if is_alarm else column.role}
        rows = []
        for source, each in zip(found, values, strict=True):
            held = [span for span in spans(source, each, SPANS) if span[2] == span[2] and (span[2] or not is_flag)]
            texts = [] if is_flag else [_text(column, value) for _, _, value in held]
            if held:
                row = {"source": self.sources.index(source.name), "texts": texts}
                rows.append(row | {"begins": [span[0] for span in held], "ends": [span[1] for span in held]})
        self.bars.append(bars | {"rows": rows})

    def _constant(self, message: Message, column: Column, texts: list[str], found: list[Source]) -> None:
        """Said in words what is the same all the time: once where it is so of all sources."""
        by_text: dict[str, list[str]] = {}
        for text, source in zip(texts, found, strict=True):
            by_text.setdefault(text, []).append(source.name)
        same = len(by_text) == 1
        said = [text if same else f"{text} ({', '.join(names)})" for text, names in by_text.items() if text]
        row = {"message": message.title, "field": column.title, "unit": column.unit, "value": ", ".join(said)}
        self.constants.append(row)


def _varies(values: Array) -> bool:
    """Whether it has two values; absent ones are none."""
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and bool((finite != finite[0]).any())


def _meaning(column: Column, values: Array) -> str:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return ""
    if column.role == "flag":
        return "set" if finite[0] else "not set"
    return _text(column, finite[0])


def _text(column: Column, value: float) -> str:
    """What an enum's number means."""
    return column.values.get(int(value)) or f"{int(value):#x}, not defined"


def _range(values: Array) -> list[float] | None:
    """Minimum, mean and maximum of what is there."""
    finite = values[np.isfinite(values)]
    return [float(finite.min()), float(finite.mean()), float(finite.max())] if len(finite) else None


def _marks(source: Source, column: Column) -> Record | None:
    """When a reserved count stood in the place of a value, and which."""
    name = f"{column.name}_special"
    if name not in source.rows.schema.names:
        return None
    special = source.rows[name]
    at = np.flatnonzero(special.is_valid().to_numpy())
    at = at[:: -(-len(at) // MARKS) or 1]
    if not len(at):
        return None
    return {"x": source.times[at].tolist(), "what": special.take(pa.array(at)).to_pylist()}


def _packed(values: Array, kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode()
