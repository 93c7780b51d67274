# SPDX-License-Identifier: GPL-2.0-or-later
"""A capture in a notebook: its messages as tables."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from .config import listed
from .dataset import flight_id
from .errors import CaptureError, MessageError, count_of, need
from .html_table import html_table
from .records import columns_of, faults, name_hint, statistics, table
from .sources import source_name
from .tables import HEAD, Message, Origin, Rows, catalogue_version, nothing_in, present
from .tables import messages as catalogue
from .tshark import Export, left_out

# The headings of the table of sources.  A newer column of the plugin is not listed: its heading is its name.
SOURCES = {"source": "source", "bus": "bus", "message": "message", "count": "count", "rate": "rate, Hz"}
SOURCES |= {"gap_min": "gap min, s", "gap_mean": "gap mean, s", "gap_max": "gap max, s", "gap_max_frame": "at frame"}
SOURCES |= {"crc_bad": "crc bad"} | {name: name for name in ("incomplete", "late", "reboots")}
HIDDEN = ("id", "controller", "other")


class Flight(Mapping[str, pa.Table]):
    """The messages of one capture: `flight["motor"]` is a pyarrow.Table, `list(flight)` are their names.

    name, flight_id: the capture's file name, and a name of its content;
    events: (n, kind, time, ...) faults, reboots, silences, bad CRCs, lost frames; times UTC in ns, lengths in seconds;
    faults: of these the flags raised and cleared; summary: a row for each bus and ID, rates in Hz, gaps in seconds;
    statistics: minimum, mean and maximum of each field of a source, in its unit;
    messages: what the catalogue says of them; plugin: its version; left_out: sentences on all that is missing here;
    partial: why a capture could not be read to its end; undecoded: what was not decoded; notes: sentences on copies.
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
        self.partial, self.undecoded = export.partial, export.undecoded
        self.complaints, self.notes = export.complaints, export.notes
        self.plugin = str(export.fields["plugin"])
        self.events = table(export.records["events"], columns_of(export.fields, "events"))
        self.faults = faults(self.events, columns_of(export.fields, "faults"))
        of_summary = columns_of(export.fields, "summary")
        self.summary = table(export.records["summary"], of_summary)
        # The headings of `sources`; those of columns that only the plugin knows are their names.
        heads = {name: name.replace("_", " ") for name in of_summary if name not in HIDDEN}
        self.heads = SOURCES | {name: text for name, text in heads.items() if name not in SOURCES}
        self.statistics = statistics(export.records["summary"], columns_of(export.fields, "statistics"))
        self.aircraft: str | None = None
        self.cards: list[dict[str, Any]] = []  # of its faults, where a page wants them
        self.catalogue = catalogue_version(export.fields)
        found = present(export)
        if not found:
            raise CaptureError(nothing_in(capture, export))
        messages, columns = listed(messages), None if columns is None else listed(columns)
        _check_words(catalogue(export.fields), messages, columns)
        self.messages: dict[str, Message] = {each.name: each for each in found if not messages or each.name in messages}
        self._titles = {name: str(entry["title"] or name) for name, entry in export.fields["messages"].items()}
        origin, self._tables = Origin(self.flight_id, capture), {}
        for message in self.messages.values():
            rows = Rows(export, message, origin, columns)
            self._tables[message.name] = pa.Table.from_batches(rows, rows.schema).unify_dictionaries()

    @property
    def hint(self) -> str:
        """What to set so that `controller` ties the messages of a controller; empty where one has a name."""
        return name_hint(self.summary)

    @property
    def left_out(self) -> list[str]:
        """Sentences on all that the capture has and the tables do not; empty where they are complete."""
        return left_out(self.partial, self.undecoded, self.complaints)

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

    def __iter__(self) -> Iterator[str]:
        """Return the names of the messages that the capture has."""
        return iter(self._tables)

    def __len__(self) -> int:
        """Return how many kinds of messages the capture has."""
        return len(self._tables)

    def plot(self, *fields: str) -> Any:
        """Return a plotly Figure of fields, "motor.rpm_measured": a line for each source, over the time in UTC.

        A line is broken where nothing came. Raises MessageError, and SetupError without plotly.
        """
        figure = need("plotly.graph_objects", "report").Figure()
        series = need(f"{__package__}.series", "report")
        for name in fields:
            message, _, field = name.partition(".")
            rows = self[message]
            if field not in rows.schema.names:
                raise MessageError(f"no field {field!r} in {message}; it has {', '.join(rows.schema.names)}")
            about = self.messages[message].columns[field]
            for source in series.sources(rows, self.messages[message].every, 0):
                times, (values,) = series.with_gaps(source, [series.numbers(source.rows[field])])
                figure.add_scatter(
                    x=(times * 1e9).astype("datetime64[ns]"), y=values, name=f"{source.name} {about.title}"
                )
            figure.update_yaxes(title=about.unit)
        return figure.update_layout(title=self.name, hovermode="x unified")

    def sources(self) -> list[dict[str, Any]]:
        """Return a row for each source, with the name that a user has for it, as pages and notebooks show it."""
        rows: list[dict[str, Any]] = self.summary.to_pylist()
        return [row | {"source": source_name(row), "message": self.title(row["message"])} for row in rows]

    def title(self, message: str | None) -> str:
        """Return the title of a message."""
        return self._titles.get(message or "", message or "unknown message")

    def _repr_html_(self) -> str:
        """Return what a notebook shows: what is missing, and a row for each source."""
        said = "".join(f"<p><b>{html.escape(text)}</b></p>" for text in [*self.left_out, *self.notes])
        table = html_table(self.heads, self.sources())
        return (
            f"<h4>{html.escape(self.name)}</h4>{said}<p>{count_of(len(self.events), 'event')}</p><table>{table}</table>"
        )

    def __repr__(self) -> str:
        """Return what is in it, on one line."""
        rows = ", ".join(f"{name}: {len(rows)}" for name, rows in self._tables.items())
        return f"<Flight {self.name} ({rows}; {count_of(len(self.events), 'event')})>"


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
