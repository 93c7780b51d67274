# SPDX-License-Identifier: GPL-2.0-or-later
"""Messages of controllers by source, as arrays, over one flight or several; thinned so that extremes and gaps stay."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .tables import said

LATE = 2.5  # a gap is longer than this many periods, as for the plugin's yapp.late
DEGREES = ("°C", "C", "degC")
APART = 1e6  # seconds between the times of two flights
Array = np.ndarray[Any, Any]


@dataclass
class Samples:
    """A message of a source. columns: {name: (n) values}; times: (n) seconds, flights APART; frames: (n).

    name: the user's name for the source, or its bus and ID; controller: the same, or the name of the controller that a
    source without a name belongs to; about: {name: the metadata of its column, with title, unit, role}; ids: (bus, ID),
    each that sent it; texts: {name: the meanings of an enum that came}; number: of the source on a page; flying, calm:
    (n) which samples are of the flight, and which of these can be compared.
    """

    name: str
    controller: str
    message: str
    title: str
    every: float
    about: Mapping[str, Mapping[str, str]]
    times: Array
    frames: Array
    columns: dict[str, Array]
    ids: set[tuple[str | None, int]]
    texts: dict[str, set[str]] = field(default_factory=dict)
    number: int = -1
    flying: Array = field(default_factory=lambda: np.zeros(0, bool))
    calm: Array = field(default_factory=lambda: np.zeros(0, bool))

    def names(self, role: str, *units: str) -> list[str]:
        """Return the columns of a role, and of these units."""
        return named(self.about, role, *units)

    def measured(self, *units: str) -> list[str]:
        """Return the values of these units that are no commands."""
        return [name for name in self.names("value", *units) if not name.endswith("_commanded")]

    def title_of(self, name: str) -> str:
        """Return the title of a column."""
        return self.about[name].get("title", name)

    def unit_of(self, name: str) -> str:
        """Return the unit of a column."""
        return self.about[name].get("unit", "")

    def supply(self) -> tuple[str, str] | None:
        """Return voltage and current of the supply: in V and A, whose names begin alike."""
        pairs = [(volts, amperes) for volts in self.names("value", "V") for amperes in self.names("value", "A")]
        return next((pair for pair in pairs if len({name.partition("_")[0] for name in pair}) == 1), None)

    def speed(self) -> tuple[str, str] | None:
        """Return what was measured and commanded; of several pairs the last: a speed stands behind a torque."""
        pairs = [(name, name.replace("_measured", "_commanded")) for name in self.names("value")]
        return next((pair for pair in reversed(pairs) if pair[0] != pair[1] and pair[1] in self.columns), None)

    def gaps(self) -> Array:
        """Return the time before each message; NaN before the first of a flight."""
        gaps = np.diff(self.times, prepend=self.times[:1] - APART)
        return np.where(gaps > APART / 2, np.nan, gaps)


def named(about: Mapping[str, Mapping[str, str]], role: str, *units: str) -> list[str]:
    """Return the columns of a role, and of these units. about: the metadata of all."""
    return [name for name, known in about.items()
            if known.get("role") == role and (not units or known.get("unit") in units)]  # fmt: skip


def split(rows: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Return the rows of each source by its name: the user's, or bus and ID, "can0 0x210"."""
    bus, source = (rows[each].cast(pa.string()) for each in ("bus", "source"))
    coded = rows["id"].combine_chunks().dictionary_encode()
    texts = pa.array([f"0x{number:03x}" for number in coded.dictionary.to_pylist()], pa.string()).take(coded.indices)
    number = pc.binary_join_element_wise(pc.fill_null(bus, ""), texts, " ")
    names = pc.utf8_trim_whitespace(pc.coalesce(source, number))
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


def samples(tables: Mapping[str, pa.Table], number: int = 0, start: int = 0) -> dict[tuple[str, str], Samples]:
    """Return the messages of each source of a flight, by (controller, message).

    tables: {message: rows}; number: of the flight, which moves its times; start: nanoseconds since 1970.
    """
    found: list[Samples] = []
    for message, table in tables.items():
        about, whole = {each.name: said(each.metadata) for each in table.schema}, said(table.schema.metadata)
        names = [name for name, known in about.items() if known.get("role") in ("value", "clock")]
        # A message without a clock of the controller, such as a command, may be for all of a bus: it is its own.
        is_own = any(known.get("role") == "clock" for known in about.values())
        title = whole.get("title", message)
        kept = [name for name in table.schema.names if about[name].get("role") not in ("flag", "flags")]
        for name, rows in split(table.select(kept)):
            rows = rows.sort_by("time")
            times = (rows["time"].cast(pa.int64()).to_numpy() - start) / 1e9
            every = float(whole.get("every") or 0) or (float(np.median(np.diff(times))) if len(times) > 1 else 1.0)
            columns = {each: numbers(rows[each]) for each in names}
            texts = {each: set(rows[f"{each}_text"].unique().to_pylist()) - {None} for each in about
                     if f"{each}_text" in about}  # fmt: skip
            ids = {(rows["bus"][0].as_py(), rows["id"][0].as_py())}
            whose, times = name if is_own else f"{name} {title}", times + number * APART
            found.append(Samples(
                name, whose, message, title, every, about, times, rows["frame"].to_numpy(), columns, ids, texts
            ))  # fmt: skip
    leads = {(bus, number & 0xF): one for one in reversed(found) if one.speed() for bus, number in one.ids}
    for one in found:
        bus, number = next(iter(one.ids))
        lead = leads.get((bus, number & 0xF))
        if lead and one.names("clock") and one.controller == f"{bus or ''} 0x{number:03x}".strip():
            one.controller = lead.controller
    return {(one.controller, one.message): one for one in sorted(found, key=lambda one: natural(one.controller))}


def joined(flights: Sequence[Mapping[tuple[str, str], Samples]]) -> dict[tuple[str, str], Samples]:
    """Return the messages of several flights, one behind the other."""
    whole: dict[tuple[str, str], Samples] = {}
    for flight in flights:
        for key, own in flight.items():
            one = whole.setdefault(key, own)
            if one is not own:
                one.times = np.concatenate([one.times, own.times])
                one.frames = np.concatenate([one.frames, own.frames])
                one.columns = {name: np.concatenate([one.columns[name], own.columns[name]]) for name in own.columns}
                one.ids |= own.ids
                one.texts = {name: one.texts[name] | own.texts[name] for name in own.texts}
    return whole


def numbers(column: pa.ChunkedArray) -> Array:
    """A column as float64, durations in seconds; where there is no value it is NaN: nothing is drawn there."""
    if pa.types.is_duration(column.type):
        return numbers(column.cast(pa.int64())) / 1e9
    values = column.cast(pa.float64(), safe=False).to_numpy()
    return np.where(np.isfinite(values), values, np.nan)


def thin(one: Samples, columns: list[Array], most: int) -> tuple[Array, list[Array]]:
    """At most about `most` samples, of several columns with the same times: of each stretch, its smallest and largest.

    Where the source was silent a sample without a value is put in, so that no line is drawn over the gap.
    """
    times = one.times
    gaps = np.flatnonzero(one.gaps() > LATE * one.every)  # the indices of the first samples behind a gap
    at = gaps
    if len(times) > most:
        size = -(-2 * len(times) // most)
        starts = np.unique(np.concatenate([np.arange(0, len(times), size), gaps]))
        columns = [np.stack([end.reduceat(column, starts) for end in (np.fmin, np.fmax)], axis=1).ravel()
                   for column in columns]  # fmt: skip
        ends = np.append(starts[1:], len(times)) - 1
        at = np.searchsorted(starts, gaps) * 2
        times = np.stack([times[starts], times[ends]], axis=1).ravel()
    thinned = np.insert(times, at, one.times[gaps - 1] + one.every)
    return thinned, [np.insert(column, at, np.nan) for column in columns]
