# SPDX-License-Identifier: GPL-2.0-or-later
"""A capture in a notebook: its messages as tables."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from .errors import CaptureError
from .tables import EVENTS, SUMMARY, Message, Rows, plugin_version, present, statistics, table
from .tshark import Export, Tshark


class Flight(Mapping[str, pa.Table]):
    """The messages of one capture: `flight["motor"]` is a pyarrow.Table, `list(flight)` are their names.

    name: the capture's file name; faults: flags raised and cleared; events: these and reboots, silences, CRC errors;
    summary: a row for each bus and ID; statistics: minimum, mean and maximum of each of their fields;
    messages: what the catalogue says of them; plugin: its version; partial: why not all could be read, or None;
    complaints: what the plugin says is wrong with its preferences or the user's messages.
    """

    def __init__(self, capture: Path, export: Export) -> None:
        """Load the tables of an export of this capture."""
        self.name = capture.name
        self.partial = export.partial
        self.complaints = export.complaints
        self.plugin = plugin_version(export.fields)
        self.events = table(export.records["events"], EVENTS)
        self.faults = self.events.filter(pc.equal(self.events["kind"], "fault")).drop_columns(
            ["kind", "length", "what", "value"]
        )
        self.summary = table(export.records["summary"], SUMMARY)
        self.statistics = statistics(export.records["summary"])
        self.messages: dict[str, Message] = {message.name: message for message in present(export)}
        if not self.messages:
            raise CaptureError(f"{capture}: no YAPP messages in it")
        self._tables = {name: _load(Rows(export, message, self.name)) for name, message in self.messages.items()}

    def __getitem__(self, message: str) -> pa.Table:
        """The rows of a message; KeyError where the capture has none."""
        return self._tables[message]

    def __iter__(self) -> Iterator[str]:
        """The names of the messages that the capture has."""
        return iter(self._tables)

    def __len__(self) -> int:
        """How many kinds of messages the capture has."""
        return len(self._tables)

    def __repr__(self) -> str:
        """What is in it, on one line."""
        rows = ", ".join(f"{name}: {len(rows)}" for name, rows in self._tables.items())
        return f"<Flight {self.name} ({rows}; {len(self.events)} events)>"


def _load(rows: Rows) -> pa.Table:
    return pa.Table.from_batches(rows, rows.schema)


def _text(path: str | PathLike[str] | None) -> str | None:
    return None if path is None else str(path)


def read(
    capture: str | PathLike[str],
    *,
    options: Sequence[str] = (),
    filter: str | None = None,  # noqa: A002
    plugin: str | PathLike[str] | None = None,
    tshark: str | PathLike[str] | None = None,
) -> Flight:
    """Read a capture with tshark and the plugin.

    options: preferences for tshark, "yapp.motor_ids:0x210,0x211"; filter: a display filter that narrows what is taken;
    plugin: yapp.lua where it is not installed; tshark: the program where it is not in PATH.
    Of a damaged capture what can be read is returned, with a warning; what the plugin complains of is one too.
    Raises YappError.
    """
    flight = read_flight(Path(capture), Tshark(_text(tshark), _text(plugin), tuple(options), filter))
    if flight.partial:
        warnings.warn(f"{capture}: read in part: {flight.partial}", stacklevel=2)
    for text in flight.complaints:
        warnings.warn(text, stacklevel=2)
    return flight


def read_flight(capture: Path, tshark: Tshark) -> Flight:
    """`read` for who has a Tshark; without its warnings."""
    with tempfile.TemporaryDirectory(prefix="yapp-tables-") as folder:
        return Flight(capture, tshark.export(capture, Path(folder, "export"), ("events", "summary")))
