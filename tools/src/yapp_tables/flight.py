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

from .errors import CaptureError, MessageError
from .tables import EVENTS, SUMMARY, Message, Rows, nothing_in, plugin_version, present, statistics, table
from .tshark import Export, Tshark
from .undecoded import left_out


class Flight(Mapping[str, pa.Table]):
    """The messages of one capture: `flight["motor"]` is a pyarrow.Table, `list(flight)` are their names.

    name: the capture's file name; faults: flags raised and cleared; events: these and reboots, silences, CRC errors;
    summary: a row for each bus and ID; statistics: minimum, mean and maximum of each of their fields;
    messages: what the catalogue says of them; plugin: its version; partial: why not all could be read, or None;
    undecoded: a sentence on the messages that were not decoded, empty where all were;
    complaints: what the plugin leaves out for another reason.
    """

    def __init__(self, capture: Path, export: Export) -> None:
        """Load the tables of an export of this capture."""
        self.name = capture.name
        self.partial = export.partial
        self.complaints = export.complaints
        self.undecoded = export.undecoded
        self.plugin = plugin_version(export.fields)
        self.events = table(export.records["events"], EVENTS)
        self.faults = self.events.filter(pc.equal(self.events["kind"], "fault")).drop_columns(
            ["kind", "length", "what", "value", "size", "count", "like"]
        )
        self.summary = table(export.records["summary"], SUMMARY)
        self.statistics = statistics(export.records["summary"])
        self.messages: dict[str, Message] = {message.name: message for message in present(export)}
        if not self.messages:
            raise CaptureError(nothing_in(capture, export))
        self._titles = {name: str(entry["title"] or name) for name, entry in export.fields["messages"].items()}
        self._tables = {name: _load(Rows(export, message, self.name)) for name, message in self.messages.items()}

    def __getitem__(self, message: str) -> pa.Table:
        """Return the rows of a message; MessageError, a KeyError, where the capture has none."""
        if message not in self._tables:
            raise MessageError(self._why_not(message))
        return self._tables[message]

    def _why_not(self, message: str) -> str:
        if message not in self._titles:
            return f"no message {message!r}; known messages: {', '.join(self._titles)}"
        why = f": {self.undecoded}" if self.undecoded else f"; it has {', '.join(self)}"
        return f"{self.name} has no decoded {self._titles[message]}{why}"

    @property
    def left_out(self) -> list[str]:
        """Sentences on all that the capture has and the tables do not; empty where they are complete."""
        return left_out(self.partial, self.undecoded, self.complaints)

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
    What is left out is a warning: the rest of a damaged capture, messages that were not decoded.
    Raises YappError.
    """
    flight = read_flight(Path(capture), Tshark(_text(tshark), _text(plugin), tuple(options), filter))
    for text in flight.left_out:
        warnings.warn(f"{capture}: {text}", stacklevel=2)
    return flight


def read_flight(capture: Path, tshark: Tshark) -> Flight:
    """`read` for who has a Tshark; without its warnings."""
    with tempfile.TemporaryDirectory(prefix="yapp-tables-") as folder:
        return Flight(capture, tshark.export(capture, Path(folder, "export")))
