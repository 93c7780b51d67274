# SPDX-License-Identifier: GPL-2.0-or-later
"""Rows by source: MF4, MCAP and pictures keep each by itself; four controllers in one channel would be a zigzag."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from .tables import is_message, plain


def split(rows: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Return the rows of each source, without dictionaries, by its name: the user's, or bus and ID, "can0 0x210"."""
    rows = plain(rows)
    coded = rows["id"].combine_chunks().dictionary_encode()
    texts = pa.array([f"0x{number:03x}" for number in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    number = pc.binary_join_element_wise(pc.fill_null(rows["bus"], ""), texts, " ")
    names = pc.utf8_trim_whitespace(pc.coalesce(rows["source"], number))
    for name in sorted(pc.unique(names).to_pylist(), key=natural):
        yield name, rows.filter(pc.equal(names, name))


def source_name(row: dict[str, Any]) -> str:
    """Return the user's name for a source, else its bus and ID: `can0 0x210`; of what has none, all of the capture."""
    number = "" if row.get("id") is None else f"0x{row['id']:03x}"
    return row.get("source") or " ".join(part for part in (row.get("bus"), number) if part) or "capture"


def controllers(events: Sequence[dict[str, Any]]) -> list[object]:
    """Return the controller of each event, None where it has no ID.

    It is a name; without one that of the same bus and last digit of the ID, if it has one; else these two.
    """
    places = [None if event["id"] is None else (event["bus"], event["id"] & 0xF) for event in events]
    names = {place: event["controller"] for place, event in zip(places, events, strict=True) if event["controller"]}
    return [event["controller"] or names.get(place, place) for place, event in zip(places, events, strict=True)]


def natural(name: str) -> list[str | int]:
    """Return what sorts names as people do: M2 before M10."""
    return [int(word) if word.isdecimal() else word for word in re.split(r"(\d+)", name)]


def by_source(table: pa.Table) -> Iterator[tuple[tuple[str, ...], pa.Table]]:
    """Return the rows of each source, and its name, of which bus and ID are two words.

    Events, faults, the summary and the flight stay together, and are called nothing.
    """
    for name, own in split(table) if is_message(table) else [("", plain(table))]:
        is_named = is_message(table) and own["source"][0].is_valid
        yield (name,) if is_named else tuple(name.split()), own.combine_chunks()


def begin(tables: Iterable[pa.Table]) -> int:
    """Return the time of the first message, in nanoseconds since 1970."""
    return int(min(rows["time"][0].value for rows in tables if is_message(rows)))


def times_of(rows: pa.Table, start: int) -> pa.ChunkedArray:
    """Return the times of rows in nanoseconds since 1970; start where there is none."""
    times = rows["time"] if "time" in rows.schema.names else pa.chunked_array([pa.nulls(len(rows))])
    return pc.fill_null(times.cast(pa.int64()), start)
