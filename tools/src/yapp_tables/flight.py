# SPDX-License-Identifier: GPL-2.0-or-later
"""A capture in a notebook: its messages as tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from .dataset import flight_id
from .errors import CaptureError, MessageError, count_of
from .records import columns_of, faults, table
from .scratch import scratch
from .tables import HEAD, Message, Origin, catalogue_version, nothing_in, present, read_rows
from .tables import messages as catalogue
from .tshark import Export, Tshark


class Flight(Mapping[str, pa.Table]):
    """The messages of one capture: `flight["motor"]` is a pyarrow.Table, `list(flight)` are their names.

    name, flight_id: the capture's file name, and a name of its content;
    events: (n, kind, time, ...) faults, reboots, silences, bad CRCs, lost frames; times UTC in ns, lengths in seconds;
    faults: of these the flags raised and cleared; summary: a row for each bus and ID, rates in Hz, gaps in seconds;
    messages: what the catalogue says of them; plugin: its version;
    left_out: sentences on all that the capture has and the tables do not; empty where they are complete;
    partial: why a capture could not be read to its end; notes: sentences on copies.
    """

    def __init__(
        self,
        capture: Path,
        export: Export,
        messages: Sequence[str] | None = None,
        columns: Sequence[str] | None = None,
        begin: int | None = None,
    ) -> None:
        """Load the tables of an export of this capture; messages, columns: these only; begin: of the capture."""
        self.name, self.flight_id, self.begin = capture.name, flight_id(capture), begin
        self.partial, self.left_out, self.notes = export.partial, export.left_out, export.notes
        self.plugin, self.catalogue = str(export.fields["plugin"]), catalogue_version(export.fields)
        self.events = table(export.records["events"], columns_of(export.fields, "events"))
        self.faults = faults(self.events, columns_of(export.fields, "faults"))
        self.summary = table(export.records["summary"], columns_of(export.fields, "summary"))
        found = present(export)
        if not found:
            raise CaptureError(nothing_in(capture, export))
        _check_words(catalogue(export.fields), messages, columns)
        self.messages: dict[str, Message] = {each.name: each for each in found if not messages or each.name in messages}
        self._titles = {name: str(entry["title"] or name) for name, entry in export.fields["messages"].items()}
        self._tables: dict[str, pa.Table] = {}
        for message in self.messages.values():
            self._tables[message.name] = read_rows(export, message, Origin(self.flight_id, capture), columns).rows

    def __getitem__(self, message: str) -> pa.Table:
        """Return the rows of a message; MessageError, a KeyError, where the capture has none."""
        if message in self._tables:
            return self._tables[message]
        if message not in self._titles:
            raise MessageError(f"no message {message!r}; known messages: {', '.join(self._titles)}")
        why = "; ".join(self.left_out) or f"it has {', '.join(self)}"
        raise MessageError(f"{self.name} has no decoded {self._titles[message]}: {why}")

    def __iter__(self) -> Iterator[str]:
        """Return the names of the messages that the capture has."""
        return iter(self._tables)

    def __len__(self) -> int:
        """Return how many kinds of messages the capture has."""
        return len(self._tables)

    def start(self) -> int:
        """Return where seconds count from, in nanoseconds since 1970: the capture's begin, or the first message."""
        return self.begin or min(pc.min(table["time"]).value for table in self._tables.values())

    def title(self, message: str | None) -> str:
        """Return the title of a message."""
        return self._titles.get(message or "", message or "unknown message")

    def __repr__(self) -> str:
        """Return what is in it, on one line."""
        rows = ", ".join(f"{name}: {len(rows)}" for name, rows in self._tables.items())
        return f"<Flight {self.name} ({rows}; {count_of(len(self.events), 'event')})>"


def read_flight(
    capture: Path,
    tshark: Tshark,
    messages: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    has_begin: bool = False,
) -> Flight:
    """Read as `read` does, without its warnings.

    has_begin: whether the first packet's time is wanted, for which tshark runs once more.
    """
    with scratch() as folder:
        export = tshark.export(capture, folder / "export")
        return Flight(capture, export, messages, columns, tshark.begin(capture) if has_begin else None)


def _check_words(known: Mapping[str, Message], messages: Sequence[str] | None, columns: Sequence[str] | None) -> None:
    """Raise MessageError for a message or a column that does not exist."""
    for name in messages or ():
        if name not in known:
            raise MessageError(f"no message {name!r}; known messages: {', '.join(known)}")
    wanted = [message for name, message in known.items() if not messages or name in messages]
    words = dict.fromkeys([*HEAD, *(name for message in wanted for name in message.columns)])
    for name in columns or ():
        if name not in words:
            where = " and ".join(message.name for message in wanted)
            raise MessageError(f"no column {name!r} in {where}; known columns: {', '.join(words)}")
