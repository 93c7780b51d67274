# SPDX-License-Identifier: GPL-2.0-or-later
"""One page with what went wrong and pictures of a capture; it opens offline, in any browser."""

from __future__ import annotations

import base64
import json
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from plotly.offline import get_plotlyjs

from .flight import Flight
from .series import Array, Source, numbers, sources, spans, thin
from .tables import Column
from .whole import write_whole

# What the page keeps of a signal of one source; the page itself thins that to what its window has room for.
SAMPLES = 100_000
MARKS = SPANS = 2_000
Record = dict[str, Any]
# What an event other than a fault means; those of the first kind are told one by one, the others counted for a source.
SINGLE = {"reboot": "reboot", "silence": "silence", "stale": "the controller's time stood still"}
COUNTED = {"crc": "bad CRC", "incomplete": "lost frames", "unfinished": "cut off by the end of the capture"}


def write_report(flight: Flight, path: Path) -> None:
    """Write the page of a flight to path. Raises OSError."""
    package = files(__package__)
    page = package.joinpath("report.html").read_text(encoding="utf-8")
    data = json.dumps(_Page(flight).data(), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    parts = {"/*PLOTLY*/": get_plotlyjs(), "/*REPORT*/": package.joinpath("report.js").read_text(encoding="utf-8")}
    head, _, tail = page.partition("/*DATA*/")
    for name, text in parts.items():
        tail = tail.replace(name, text, 1)
    write_whole(path, head + data + tail)


class _Page:
    """What the page shows of a flight, as JSON that report.js reads."""

    def __init__(self, flight: Flight) -> None:
        self.flight = flight
        times = [flight[name]["time"] for name in flight]
        self.start = min(pc.min(column).value for column in times)
        self.length = (max(pc.max(column).value for column in times) - self.start) / 1e9
        self.sources: list[str] = []
        self.times: list[str] = []
        self.panels: dict[str, Record] = {}
        self.bars: list[Record] = []

    def data(self) -> Record:
        flight = self.flight
        for name, message in flight.messages.items():
            for source in sources(flight[name], message.every, self.start):
                if source.name not in self.sources:
                    self.sources.append(source.name)
                self._lines(name, source)
                self._bars(name, source)
        begin = datetime.fromtimestamp(self.start / 1e9, UTC)
        return {
            "name": flight.name,
            "start": f"{begin:%Y-%m-%d %H:%M:%S} UTC",
            "length": self.length,
            "partial": flight.partial,
            "versions": f"YAPP plugin {flight.plugin}, yapp-tables {version('yapp-tables')}",
            "faults": self._faults(),
            "others": self._others(),
            "sources": self.sources,
            "times": self.times,
            "panels": list(self.panels.values()),
            "bars": sorted(self.bars, key=lambda bar: (bar["kind"], bar["title"], bar["source"])),
            "summary": _rows(flight.summary),
            "statistics": _rows(flight.statistics),
        }

    def _since(self, time: int) -> float:
        return float(time - self.start) / 1e9

    def _events(self) -> list[Record]:
        """The events, with `at` in seconds since the start and the source's name as in the pictures."""
        events: list[Record] = self.flight.events.set_column(
            0, "at", self.flight.events["time"].cast(pa.int64())
        ).to_pylist()
        return [
            event | {"at": self._since(event["at"]), "source": _source(event), "title": self._title(event["message"])}
            for event in events
        ]

    def _title(self, message: str | None) -> str:
        known = self.flight.messages.get(message or "")
        return known.title if known else message or "unknown message"

    def _faults(self) -> list[Record]:
        """Each fault from raised to cleared, or to the end of the capture where `end` is None."""
        rows: list[Record] = []
        open_rows: dict[tuple[str, str, str], Record] = {}
        for event in self._events():
            if event["kind"] != "fault":
                continue
            key = event["source"], event["message"], event["flag"]
            if event["event"] == "raised":
                row = {
                    "begin": event["at"],
                    "end": None,
                    "length": self.length - event["at"],
                    "source": event["source"],
                }
                open_rows[key] = row | {"message": event["title"], "what": self._flag(event), "flag": event["flag"]}
                rows.append(open_rows[key])
            elif key in open_rows:
                row = open_rows.pop(key)
                row["end"] = event["at"] if event["event"] == "cleared" else None
                row["length"] = event["active"]
        return rows

    def _flag(self, event: Record) -> str:
        message = self.flight.messages.get(event["message"])
        for column in message.columns.values() if message else ():
            if column.role == "flag" and column.name.endswith(f"_{event['flag']}"):
                return column.title
        return str(event["flag"])

    def _others(self) -> list[Record]:
        """Reboots and silences one by one; bad CRCs and lost frames as one row for each source."""
        rows: list[Record] = []
        counted: dict[tuple[str, str], Record] = {}
        for event in self._events():
            at, kind = event["at"], event["kind"]
            row = {"begin": at, "end": at + (event["length"] or 0.0), "length": event["length"], "count": 1}
            row |= {"source": event["source"], "message": event["title"], "kind": kind}
            if kind in SINGLE:
                rows.append(row | {"what": SINGLE[kind]})
            elif kind in COUNTED:
                known = counted.setdefault((kind, event["source"]), row | {"what": COUNTED[kind], "count": 0})
                known["end"], known["count"] = at, known["count"] + 1
        return sorted([*rows, *counted.values()], key=lambda row: row["begin"])

    def _lines(self, message: str, source: Source) -> None:
        """The values of a source: a panel for each unit, its times once, marks where there was a reserved count."""
        known = self.flight.messages[message].columns
        columns = [known[name] for name in source.rows.schema.names if name in known and known[name].role == "value"]
        if not columns:
            return
        times, lines = thin(source, [numbers(source.rows[column.name]) for column in columns], SAMPLES)
        self.times.append(_packed(times, "<f8"))
        for column, values in zip(columns, lines, strict=True):
            panel = self.panels.setdefault(
                column.unit or message, {"unit": column.unit, "fields": [], "traces": [], "marks": []}
            )
            field = {"name": column.name, "title": column.title, "message": message}
            if field not in panel["fields"]:
                panel["fields"].append(field)
            trace = {"source": self.sources.index(source.name), "field": panel["fields"].index(field)}
            panel["traces"].append(trace | {"x": len(self.times) - 1, "y": _packed(values, "<f4")})
            if marks := _marks(source, column):
                panel["marks"].append(trace | marks)

    def _bars(self, message: str, source: Source) -> None:
        """What a source's enums said when, and when its flags were set."""
        for column in self.flight.messages[message].columns.values():
            if column.role not in ("enum", "flag") or column.name not in source.rows.schema.names:
                continue
            values = numbers(source.rows[column.name].cast(pa.int64()))
            found = [
                span
                for span in spans(source, values, SPANS)
                if span[2] == span[2] and (column.role == "enum" or span[2])
            ]
            if found:
                texts = (
                    [column.values.get(int(value), str(int(value))) for _, _, value in found] if column.values else []
                )
                bar = {
                    "source": self.sources.index(source.name),
                    "title": column.title,
                    "kind": column.role,
                    "texts": texts,
                }
                self.bars.append(bar | {"begins": [span[0] for span in found], "ends": [span[1] for span in found]})


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


def _source(row: Record) -> str:
    return row["source"] or " ".join(part for part in (row["bus"], f"0x{row['id']:03x}") if part)


def _rows(table: pa.Table) -> list[Record]:
    """A table's rows with the source's name in the place of bus and id; no number that JSON does not have."""
    kept = ("bus", "id")
    return [
        {name: value for name, value in (row | {"source": _source(row)}).items() if name not in kept}
        for row in table.to_pylist()
    ]
