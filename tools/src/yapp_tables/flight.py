# SPDX-License-Identifier: GPL-2.0-or-later
"""A capture in a notebook: its messages as tables."""

import hashlib
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from . import __version__
from .errors import CaptureError, count_of
from .incidents import faults_in
from .scratch import scratch
from .series import samples
from .steps import aligned, point_columns, points, steps
from .tables import TABLES, catalogue_version, columns_of, read_rows, record_column, table, to_write
from .tables import messages as catalogue
from .tshark import Export, Record, Tshark

StrPath = str | os.PathLike[str]
# A step of the capture's clock, in seconds, that counts as "it was set".
SET = 1.0
# Nobody recorded before 2000: an earlier time counts from the recorder's own start. Nanoseconds since 1970.
YEAR_2000 = 946_684_800_000_000_000


def flight_id(capture: Path) -> str:
    """Return the name of a capture's content: the first 16 digits of its SHA-256."""
    with capture.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


class Flight(dict[str, pa.Table]):
    """The messages of one capture: `flight["motor"]` is a pyarrow.Table, `list(flight)` are their names.

    name, flight_id: the capture's file name, and a name of its content;
    events: (n, kind, time, ...) faults, reboots, silences, bad CRCs, lost frames; times UTC in ns, lengths in seconds;
    faults: of these the flags raised and cleared; summary: a row for each bus and ID, rates in Hz, gaps in seconds;
    buses: a row for each CAN bus, if bitrate is given; plugin: its version;
    messages: {name: pyarrow.Schema}, what the catalogue says of them;
    left_out: sentences on all that the capture has and the tables do not; empty where they are complete;
    partial: why a capture could not be read to its end; notes: sentences on copies.
    """

    def __init__(self, capture: Path, export: Export, begin: int | None = None) -> None:
        """Load the tables of an export of this capture; begin: of the capture."""
        self.name, self.flight_id, self.begin = capture.name, flight_id(capture), begin
        self.partial, self.notes = export.partial, list(export.notes)
        self.left_out = [*([f"read in part: {self.partial}"] if self.partial else []), *export.lacks]
        self.plugin, self.catalogue = str(export.fields["plugin"]), catalogue_version(export.fields)
        self.records = {name: columns_of(export.fields, name) for name in TABLES}
        self.events = table(export.records["events"], self.records["events"])
        named = [name for name in self.records["faults"].names if name in self.events.schema.names]
        self.faults = self.events.filter(pc.equal(self.events["kind"].cast(pa.string()), "fault")).select(named)
        self.summary = table(export.records["summary"], self.records["summary"])
        self.buses = table(export.records["buses"], self.records["buses"])
        known = catalogue(export.fields)
        self.records["points"] = pa.schema([*self.records["points"], *map(record_column, point_columns(known))])
        self.titles: dict[str, str] = {name: schema.metadata[b"title"].decode() for name, schema in known.items()}
        self.about = {"source_file": self.name, "flight_id": self.flight_id}
        every = {
            name: read_rows(export.folder / f"{name}.csv", known[name], entry, self.about)
            for name, entry in export.fields["messages"].items()
        }
        super().__init__({name: rows for name, rows in every.items() if len(rows)})
        self.messages = {name: known[name] for name in self}
        if not self:
            raise CaptureError(": ".join([f"{capture}: no YAPP messages in it", *self.left_out]))

    def __missing__(self, message: str) -> pa.Table:
        """Raise KeyError, with a sentence, where the capture has none of a message."""
        if message not in self.titles:
            raise KeyError(f"no message {message!r}; known messages: {', '.join(self.titles)}")
        why = "; ".join(self.left_out) or f"it has {', '.join(self)}"
        raise KeyError(f"{self.name} has no decoded {self.titles[message]}: {why}")

    def start(self) -> int:
        """Return where seconds count from, in nanoseconds since 1970: the capture's begin, or the first message."""
        return self.begin or min(pc.min(table["time"]).value for table in self.values())

    def tables(self, capture: Path, options: Sequence[str], log: Path | None = None) -> dict[str, pa.Table]:
        """Return its messages, events, faults, summary, steps, points and the flight itself, as a data set has them.

        log: of a thrust stand. Raises YappError where that does not fit.
        """
        start = self.start()
        found = samples(self, start=start)
        bench, columns = aligned(log, found) if log else None, list(self.records["points"])
        if bench:
            self.notes.append(bench.said)
            about = {"type": "number", "help": "its mean, of the bench's log"}
            columns += [record_column({"name": name} | about) for name in bench.columns]

        def timed(rows: Iterator[Record], schema: pa.Schema) -> pa.Table:
            return table((row | {"time": Decimal(start + round(row["at"] * 1e9)).scaleb(-9)} for row in rows), schema)

        records = {name: getattr(self, name) for name in ("events", "faults", "summary", "buses")} | {
            "steps": timed(steps(found), self.records["steps"]),
            "points": timed(points(found, bench), pa.schema(columns)),
            "flights": pa.Table.from_pylist([self._row(capture, options)], self.records["flights"]),
        }
        return self | {name: to_write(name, rows, self.about) for name, rows in records.items()}

    def _row(self, capture: Path, options: Sequence[str]) -> Record:
        """Return the row of `flights`."""
        ends = sorted((rows["frame"][at].as_py(), rows["time"][at].value) for rows in self.values() for at in (0, -1))
        start, last = ends[0][1], ends[-1][1]
        events = self.events.filter(pc.equal(self.events["kind"].cast(pa.string()), "clock"))
        steps = [step for step in events["length"].to_pylist() if abs(step or 0) > SET]
        left_out = [*self.left_out[bool(self.partial) :], *self.notes]
        if steps:
            times = count_of(len(steps), "time")
            left_out.append(f"the capture's clock was set {times}: times before and after do not compare")
        if start < YEAR_2000:
            left_out.append("the capture tells no absolute time: times count from 1970")
        return {
            "capture": str(capture),
            "start": start if start >= YEAR_2000 else None,
            "length": (last - start) / 1e9 - sum(steps),
            "plugin": self.plugin,
            "tools": __version__,
            "options": " ".join(options),
            "messages": sum(map(len, self.values())),
            "faults": faults_in(self.events),
            "partial": self.partial,
            "left_out": "; ".join(left_out) or None,
        }


def read_flight(capture: Path, tshark: Tshark, has_begin: bool = False) -> Flight:
    """Read as `read` does, without its warnings; has_begin: run tshark once more, for the first packet's time."""
    with scratch() as folder:
        export = tshark.export(capture, folder / "export")
        if not has_begin:
            return Flight(capture, export)
        first = tshark.run(capture, ["-c", "1", "-T", "fields", "-e", "frame.time_epoch"]).strip()
        return Flight(capture, export, int(Decimal(first).scaleb(9)) if re.fullmatch(r"\d+\.\d+", first) else None)


def read(capture: StrPath, **how: Any) -> Flight:
    """Read a capture with tshark and the plugin.

    What is left out is a warning: the rest of a damaged capture, messages that were not decoded.
    Returns a Flight. Raises YappError.
    """
    flight = read_flight(Path(capture), Tshark(**how))
    for text in flight.left_out:
        warnings.warn(f"{capture}: {text}", stacklevel=2)
    return flight
