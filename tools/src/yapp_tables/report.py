# SPDX-License-Identifier: GPL-2.0-or-later
"""One page with what went wrong and pictures of a capture; it opens offline, in any browser."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
from plotly.offline import get_plotlyjs

from .config import StrPath
from .errors import SetupError
from .flight import Flight
from .pictures import MARKS, Pictures, Record
from .tables import Column
from .undecoded import source_name
from .whole import write_whole

# What an event other than a fault means; those of the first kind are told one by one, the others counted for a source.
SINGLE = {
    "reboot": "reboot",
    "silence": "silence",
    "absent": "never came",
    "shared": "two controllers share this ID: its other events are left out",
    "jump": "the controller's clock jumped ahead",
    "clock": "the capture's clock went back",
}
COUNTED = {
    "missing": "messages missing by Seq No",
    "dropped": "packets dropped while capturing",
    "stale": "the controller's time stood still",
    "crc": "bad CRC",
    "incomplete": "lost frames",
    "unfinished": "cut off by the end of the capture",
    "skipped": "bytes of no frame",
    "invalid": "undefined value",
}


def write_report(flight: Flight, path: Path, begin: int | None = None) -> None:
    """Write the page of a flight to path.

    begin: the time of the capture's first packet, from which seconds count as in Wireshark; None for that of the first
    message. Raises OSError.
    """
    package = files(__package__)
    page = package.joinpath("report.html").read_text(encoding="utf-8")
    data = json.dumps(_Page(flight, begin).data(), ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    parts = {"/*PLOTLY*/": get_plotlyjs(), "/*REPORT*/": package.joinpath("report.js").read_text(encoding="utf-8")}
    head, _, tail = page.partition("/*DATA*/")
    for name, text in parts.items():
        tail = tail.replace(name, text, 1)
    write_whole(path, head + data + tail)


def write_reports(
    flights: Sequence[Flight], captures: Sequence[Path], out: StrPath | None = None, overlay: bool = False
) -> Path:
    """Write the page of a flight, or a folder of pages. Returns the page. Raises SetupError."""
    assert not overlay
    page = captures[0].with_suffix(".html") if out is None else Path(out)
    if not page.parent.is_dir():
        raise SetupError(f"{page} cannot be written: no folder {page.parent}")
    try:
        write_report(flights[0], page, flights[0].begin)
    except OSError as error:
        raise SetupError(f"{page} cannot be written: {error.strerror}") from error
    return page


class _Page:
    """What the page shows of a flight, as JSON that report.js reads."""

    def __init__(self, flight: Flight, begin: int | None) -> None:
        self.flight = flight
        times = [flight[name]["time"] for name in flight]
        self.start: int = min(pc.min(column).value for column in times) if begin is None else begin
        self.end = self._since(max(pc.max(column).value for column in times))
        self.pictures = Pictures(self.start)
        self.events = self._events()

    def data(self) -> Record:
        flight, pictures = self.flight, self.pictures
        faults, others = self._faults(), self._others()
        # First the message that says most.
        for message in sorted(flight.messages.values(), key=lambda message: -len(message.columns)):
            alarms = {column.name for event in self.events if (column := self._flag(event, message.name))}
            pictures.add(message, flight[message.name], alarms)
        marks = self._marks(others)
        begin = datetime.fromtimestamp(self.start // 10**9, UTC)
        return {
            "name": flight.name,
            "start": f"{begin:%Y-%m-%d %H:%M:%S}{f'.{self.start % 10**9:09}'.rstrip('0').rstrip('.')} UTC",
            "length": self.end,
            "partial": flight.partial,
            "undecoded": flight.undecoded,
            "complaints": flight.complaints,
            "versions": f"YAPP plugin {flight.plugin}, yapp-tables {version('yapp-tables')}",
            "faults": faults,
            "others": others,
            "sources": pictures.sources,
            "legend": pictures.legend(),
            "times": pictures.times,
            "panels": pictures.panels,
            "bars": marks + sorted(pictures.bars, key=lambda bars: ("fault", "enum", "flag").index(bars["kind"])),
            "summary": self._summary(),
            "values": pictures.values,
            "constants": pictures.constants,
        }

    def _since(self, time: int) -> float:
        return float(time - self.start) / 1e9

    def _events(self) -> list[Record]:
        """The events, with `at` in seconds since the start and the source's name as in the pictures."""
        events: list[Record] = self.flight.events.set_column(
            0, "at", self.flight.events["time"].cast(pa.int64())
        ).to_pylist()
        return [
            event
            | {
                "at": 0.0 if event["at"] is None else self._since(event["at"]),
                "source": source_name(event),
                "title": self._title(event["message"]),
            }
            for event in events
        ]

    def _title(self, message: str | None) -> str:
        known = self.flight.messages.get(message or "")
        return known.title if known else message or "unknown message"

    def _faults(self) -> list[Record]:
        """Each fault from raised to cleared, or to the end of the capture where `end` is None."""
        rows: list[Record] = []
        open_rows: dict[tuple[str, str, str], Record] = {}
        for event in self.events:
            if event["kind"] != "fault":
                continue
            key = event["source"], event["message"], event["flag"]
            if event["event"] == "raised":
                flag = self._flag(event, event["message"])
                row = {"begin": event["at"], "end": None, "length": self.end - event["at"], "source": event["source"]}
                row |= {"message": event["title"], "what": flag.title if flag else event["flag"], "help": event["help"]}
                open_rows[key] = row
                rows.append(row)
            elif key in open_rows:
                row = open_rows.pop(key)
                row["end"] = event["at"] if event["event"] == "cleared" else None
                row["length"] = event["active"]
        return rows

    def _flag(self, event: Record, message: str) -> Column | None:
        """The column of the flag that an event is about, where it is one of this message."""
        known = self.flight.messages.get(message)
        if known is None or event["kind"] != "fault" or event["message"] != message:
            return None
        flags = (column for column in known.columns.values() if column.role == "flag")
        return next((column for column in flags if column.name.endswith(f"_{event['flag']}")), None)

    def _others(self) -> list[Record]:
        """Reboots and silences one by one; what may come often as one row for each source, with its times in `at`."""
        rows: dict[tuple[str, ...], Record] = {}
        for number, event in enumerate(self.events):
            kind, length = event["kind"], event["length"] or 0.0
            if kind not in SINGLE and kind not in COUNTED:
                continue
            what = SINGLE.get(kind) or COUNTED[kind]
            if kind == "invalid":
                what = f"{what}: {self._value(event)}"
            key = (kind, event["source"], what) if kind in COUNTED else (str(number),)
            row = {"what": what, "source": event["source"], "begin": event["at"], "end": event["at"], "count": 0}
            row |= {"length": None, "bytes": None, "message": event["title"], "at": []}
            row = rows.setdefault(key, row)
            row["count"] += event["count"] or 1
            row["at"].append(event["at"])
            row["end"] = event["at"]
            if kind == "silence":
                row["end"], row["length"] = event["at"] + length, length
            if kind == "skipped":
                row["bytes"] = (row["bytes"] or 0) + int(length)
        return sorted(rows.values(), key=lambda row: row["begin"])

    def _value(self, event: Record) -> str:
        """What a field had that the catalogue does not define: "Key 0x11"."""
        message = self.flight.messages.get(event["message"])
        column = message.columns.get(event["field"]) if message else None
        value = event["value"] or ""
        return f"{column.title if column else event['field']} {int(value):#x}" if value.isdigit() else value

    def _marks(self, others: list[Record]) -> list[Record]:
        """The events on the time axis: a line for each kind and source; one that does not last is a mark."""
        bars: dict[str, Record] = {}
        for row in others:
            bar = bars.setdefault(row["what"], {"title": row["what"], "message": "", "kind": "event", "rows": {}})
            source = self.pictures.source(row["source"], row["message"])
            marks = bar["rows"].setdefault(source, {"source": source, "texts": [], "begins": [], "ends": []})
            at = row["at"][:: -(-len(row["at"]) // MARKS)]
            marks["begins"] += at
            marks["ends"] += [row["end"]] if row["length"] else at
        return [bar | {"rows": list(bar["rows"].values())} for bar in bars.values()]

    def _summary(self) -> list[Record]:
        """A row for each source; what the plugin does not count is left out."""
        rows: list[Record] = self.flight.summary.to_pylist()
        names = [name for name in self.flight.summary.schema.names if any(row[name] is not None for row in rows)]
        about = ({name: row[name] for name in names if name not in ("bus", "id")} for row in rows)
        return [
            row | {"source": source_name(given), "message": self._title(given["message"])}
            for row, given in zip(about, rows, strict=True)
        ]
