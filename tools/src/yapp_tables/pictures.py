# SPDX-License-Identifier: GPL-2.0-or-later
"""The pictures of a page: figures of values, lanes of states, what one value does over another, what never changed."""

from __future__ import annotations

import base64
import gzip
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .differs import calm_samples, differing, flying, sagging
from .limits import Limits, beyond
from .matrix import DEGREES, Part
from .series import Array, Source, numbers, sources, spans, thin
from .tables import Column, Message

# What the page keeps of a signal of one source, and of all together; it thins that to what its window has room for.
SAMPLES, ALL_SAMPLES = 100_000, 3_500_000
MARKS = SPANS = 2_000
CLOUD = 500  # points of one source, and of its largest values
CLOUD_ENDS = 20
ODD, ODD_ONCE = 1.25, 1.5  # times the others' current at the same speed, over the flight and once
APART = 0.1  # and by this share of the largest
ODD_SHARE = 0.1  # of the points of a source: with fewer it is not called odd
# Shades of one source from another's: (bus, ID) of a controller, not its place in a list, says its colour.
COLOURS, IDS_OF_A_BUS = 16, 8
Record = dict[str, Any]
Windows = Sequence[tuple[float, float]]


class Pictures:
    """What report.js draws, as JSON.

    sources: {name, label, colour, flight, controller} of each; times: the x axes that lines share; figures, clouds:
    [{title, unit, message, key, lines, marks, limits}]; lanes: [{title, message, kind, rows}]; level: sentences on what
    never changed; differs: who is different from the others; parts: the messages, for tables that are made elsewhere.
    """

    def __init__(self, start: int, limits: Limits, signals: int = 1) -> None:
        """start: nanoseconds since 1970; signals: about how many there are, of all sources."""
        self.start, self.limits, self.flight = start, limits, 0
        self.samples = max(2_000, min(SAMPLES, ALL_SAMPLES // max(1, signals)))
        self.sources: list[Record] = []
        self.parts: list[Part] = []
        self.times: list[Record] = []
        self.figures: list[Record] = []
        self.clouds: list[Record] = []
        self.lanes: list[Record] = []
        self.level: list[str] = []
        self.differs: list[Record] = []
        self.phases: list[tuple[float, float]] = []  # in flight, of the flight that is drawn
        self.bytes = bytearray()
        self._leads: dict[object, Record] = {}  # the first source of each controller

    def add(
        self, message: Message, table: pa.Table, alarms: set[str], excused: Mapping[str, Windows], prefix: str = ""
    ) -> None:
        """Draw a message, that with the speed first.

        alarms: the flags of it that were faults, each by its column; excused: of sources, when they are not compared;
        prefix: of sources' names.
        """
        found = list(sources(table, message.every, self.start))
        # A message without a clock of the controller, such as a command, may be for all of a bus.
        is_own = any(column.role == "clock" for column in message.columns.values())
        whose = [self.source(prefix + source.name, first_of(source), message.title, is_own) for source in found]
        known = (column for column in message.columns.values() if column.name in table.schema.names)
        columns = [column for column in known if column.role in ("value", "enum", "flag")]
        values = {column.name: [numbers(source.rows[column.name]) for source in found] for column in columns}
        part = Part(message, found, whose, values)
        self.phases = flying(part) or self.phases
        part.flying = [calm_samples(source, self.phases, ()) for source in found]
        part.calm = [calm_samples(source, self.phases, excused.get(source.name, ())) for source in found]
        self.parts.append(part)
        said = differing(part, alarms) + self._limited(part) + sagging(part, self.phases)
        self.differs += [row | {"source": prefix + row["source"]} for row in said]
        self._clouds(part)
        self._figures(part)
        for column in columns:
            if column.role != "value":
                self._lane(part, column, column.name in alarms)

    def source(self, name: str, row: Record, title: str = "", is_own: bool = True) -> int:
        """Return the number of a source. title: of its message; is_own: whether only this controller sends that."""
        known = [source["name"] for source in self.sources]
        if name in known:
            return known.index(name)
        bus, of_bus = row.get("bus") or "", row.get("id")
        is_one = is_own and of_bus is not None
        key = (self.flight, bus, of_bus & 0xF) if is_one and of_bus is not None else (self.flight, name)
        lead = self._leads.get(key)
        label = f"{name} ({bus})" if bus and not name.rpartition(": ")[2].startswith(bus) else name
        # A source that has no name of the user's is called by the controller's, if that has one.
        if lead and lead["label"] not in (lead["name"], name) and label == name:
            label = f"{lead['label']}, {title or name}"
        number = len(self.sources)
        about = {"name": name, "label": label, "colour": _colour(bus, of_bus) if is_own else "command"}
        about |= {"flight": self.flight, "is_command": not is_own}
        self.sources.append(about | {"controller": lead["controller"] if lead else len(self._leads)})
        self._leads.setdefault(key, self.sources[-1])
        return number

    def blob(self) -> str:
        """Return all samples, packed."""
        return packed(bytes(self.bytes))

    def limits_told(self) -> list[str]:
        """Return the limits of what is drawn: "Motor Temperature at most 120 °C"."""
        told = []
        for figure in self.figures:
            low, high = figure["limits"]
            words = [f"at least {low:g}"] if low is not None else []
            words += [f"at most {high:g}"] if high is not None else []
            if words:
                told.append(f"{figure['title']} {' and '.join(words)} {figure['unit']}".strip())
        return told

    def ordered(self) -> list[Record]:
        """Return the figures: speed, current of the supply, motor temperature and voltage first."""
        first: list[str] = []
        for part in self.parts:
            speed, supply = part.speed(), part.supply()
            wanted = [speed[0] if speed else None, supply[1] if supply else None, *part.fields(*DEGREES)[:1]]
            wanted += [supply[0] if supply else None]
            first += [f"{part.message.name}.{one.name}" for one in wanted if one]
        figures = overlaid(self.figures)
        return sorted(figures, key=lambda one: first.index(one["key"]) if one["key"] in first else len(first))

    def _limited(self, part: Part) -> list[Record]:
        """Say which values were outside the limits of the rules."""
        said = []
        for column in (part.message.columns[name] for name in part.values):
            for source, values, use in zip(part.found, part.values[column.name], part.flying, strict=True):
                limits = self.limits.of(source.name, part.message.name, column.name)
                said += beyond(source, values, limits, column, use)
        return [row | {"is_supply": row["field"] in [one.name for one in part.supply() or ()]} for row in said]

    def _figures(self, part: Part) -> None:
        """A figure for each value of all sources, with its command; marks where there was a reserved count."""
        fields = [part.message.columns[name] for name in part.values if part.message.columns[name].role == "value"]
        marks = {column.name: [_marks(source, column) for source in part.found] for column in fields}
        drawn = [one for one in fields if any(map(_varies, part.values[one.name])) or _partly(one, part.values, marks)]
        figures = {column.name: self._figure(part, column) for column in drawn}
        for number, source in enumerate(part.found if drawn else ()):
            times, lines = thin(source, [part.values[column.name][number] for column in drawn], self.samples)
            line = {"source": part.whose[number], "x": self._times(times)}
            for column, own in zip(drawn, lines, strict=True):
                figures[column.name]["lines"].append(line | {"name": column.title, "y": self._keep(own, "<f4")})
                if mark := marks[column.name][number]:
                    figures[column.name]["marks"].append({"source": part.whose[number], "name": column.title} | mark)
        for column in drawn:
            figure = figures[column.name]
            told = figures.get(column.name.replace("_measured", "_commanded"), figure)
            if told is not figure:
                figure["lines"] = [asked | {"dash": "dash"} for asked in told["lines"]] + figure["lines"]
                figure["marks"] += told["marks"]
                self.figures.remove(told)
            named = {column.name, column.name.replace("_measured", "_commanded")}
            odd = {row["source"] for row in self.differs if row["field"] in named and row["kind"] != "left"}
            about = (self.sources[who] for who in part.whose)
            figure["odd"] = sorted({one["controller"] for one in about if one["name"] in odd})
        self._intervals(part)

    def _figure(self, part: Part, column: Column) -> Record:
        """A figure, still without lines, with the narrowest limits of all sources."""
        limits = [self.limits.of(source.name, part.message.name, column.name) for source in part.found]
        low, high = max(one[0] for one in limits), min(one[1] for one in limits)
        about: Record = {"title": column.title, "unit": column.unit, "message": part.message.title}
        about |= {"lines": [], "marks": [], "odd": []}
        about["key"] = f"{part.message.name}.{column.name}"
        about["limits"] = [one if np.isfinite(one) else None for one in (low, high)]
        self.figures.append(about)
        return about

    def _intervals(self, part: Part) -> None:
        """How long it was between two messages of a source."""
        figure: Record = {"title": "Interval between messages", "unit": "s", "message": part.message.title}
        figure |= {"key": "", "lines": [], "marks": [], "odd": [], "limits": [None, None]}
        for source, who in zip(part.found, part.whose, strict=True):
            if len(source.times) < 3:
                continue
            unbroken = Source(source.name, source.rows, source.times[1:], np.inf)
            times, (own,) = thin(unbroken, [np.diff(source.times)], self.samples // 4)
            figure["lines"].append(
                {"source": who, "name": figure["title"], "x": self._times(times), "y": self._keep(own, "<f4")}
            )
        if figure["lines"]:
            self.figures.append(figure)

    def _clouds(self, part: Part) -> None:
        """Current over speed and voltage over all current, a cloud a source; what is odd at its speed is marked."""
        pair, speeds = part.supply(), part.speed()
        if not pair:
            return
        volts, amperes = pair
        current = part.values[amperes.name]
        odd, times = [np.zeros(len(own), bool) for own in current], [1.0] * len(current)
        if speeds:
            speed = part.values[speeds[0].name]
            calm = [np.where(use, own, np.nan) for use, own in zip(part.calm, current, strict=True)]
            odd, times = _apart(speed, calm)
            self._cloud(part, (speeds[0], amperes), speed, current, odd)
            shares = [float(own.mean()) for own in odd]
            self.clouds[-1]["odd"] = [
                f"{self.sources[who]['label']} in {share:.0%} of its points, {much:.2f} times the others'"
                for who, share, much in zip(part.whose, shares, times, strict=True)
                if share > ODD_SHARE
            ]
        every = Column("total", amperes.type, "value", "Current of all", amperes.unit)
        none = [np.zeros(len(own), bool) for own in current]
        self._cloud(part, (every, volts), _total(part.found, current), part.values[volts.name], none)

    def _cloud(self, part: Part, axes: tuple[Column, Column], x: list[Array], y: list[Array], odd: list[Array]) -> None:
        title, lines = f"{axes[1].title} over {axes[0].title}", []
        for who, across, up, is_odd in zip(part.whose, x, y, odd, strict=True):
            good = np.flatnonzero(np.isfinite(across) & np.isfinite(up))
            if len(good):
                order = good[np.argsort(up[good])]
                marked = good[is_odd[good]][: CLOUD // 2]
                ends = np.concatenate([order[:CLOUD_ENDS], order[-CLOUD_ENDS:], marked])
                kept = np.unique(np.concatenate([good[:: -(-len(good) // CLOUD)], ends]))
                points = {"x": self._keep(across[kept], "<f4"), "y": self._keep(up[kept], "<f4")}
                lines.append({"source": who, "name": title, "odd": np.flatnonzero(is_odd[kept]).tolist()} | points)
        about = {"title": title, "message": part.message.title, "lines": lines, "marks": [], "unit": axes[1].unit}
        about["key"] = ""
        self.clouds.append(about | {"across": f"{axes[0].title}, {axes[0].unit}", "odd": []})

    def _times(self, times: Array) -> int:
        """Keep an x axis; returns its number."""
        self.times.append(self._keep(np.diff(np.round(times * 1e6), prepend=0), "<i4"))
        return len(self.times) - 1

    def _keep(self, values: Array, kind: str) -> Record:
        """Keep samples, all first bytes, then all second ones: so they pack well."""
        data = np.frombuffer(values.astype(kind).tobytes(), np.uint8).reshape(-1, 4).T.tobytes()
        self.bytes += data
        return {"at": len(self.bytes) - len(data), "count": len(values)}

    def _lane(self, part: Part, column: Column, is_alarm: bool) -> None:
        """What an enum said when, or when a flag was set; a sentence where that never changed."""
        is_flag, values = column.role == "flag", part.values[column.name]
        if is_flag and not any(np.nanmax(each, initial=0) for each in values):
            return
        if not is_alarm and not any(map(_varies, values)):
            self._fold(part, column)
            return
        rows = []
        for source, who, each in zip(part.found, part.whose, values, strict=True):
            held = [span for span in spans(source, each, SPANS) if span[2] == span[2] and (span[2] or not is_flag)]
            texts = [] if is_flag else [_text(column, value) for _, _, value in held]
            row = {"begins": [each[0] for each in held], "ends": [each[1] for each in held]}
            rows += [row | {"source": who, "texts": texts}] if held else []
        kind = "fault" if is_alarm else column.role
        about = {"title": column.title, "message": part.message.title, "key": column.name}
        self.lanes.append(about | {"kind": kind, "rows": rows})

    def _fold(self, part: Part, column: Column) -> None:
        """Say what a state was all the time."""
        groups: dict[str, list[str]] = {}
        for who, each in zip(part.whose, part.values[column.name], strict=True):
            for value in each[np.isfinite(each)][:1]:
                text = ("set" if value else "not set") if column.role == "flag" else _text(column, value)
                groups.setdefault(text, []).append(self.sources[who]["label"])
        texts = list(groups) if len(groups) == 1 else [f"{text} ({', '.join(who)})" for text, who in groups.items()]
        self.level.append(f"{column.title}: {', '.join(texts)}")


def overlaid(pictures: list[Record]) -> list[Record]:
    """Return pictures of several flights with one for each value: those of later flights lie over the first one's."""
    found: dict[tuple[str, str, str], Record] = {}
    for one in pictures:
        first = found.setdefault((one["title"], one["message"], one["key"]), one)
        if first is not one:
            first |= {name: first[name] + one[name] for name in ("lines", "marks", "odd", "rows") if name in one}
    return list(found.values())


def _apart(speed: list[Array], current: list[Array]) -> tuple[list[Array], list[float]]:
    """Return which samples are far from the others' median at the same speed, and how many times it they are.

    All are of who is so all the time.
    """
    odd, times = [np.zeros(len(own), bool) for own in current], [1.0] * len(current)
    finite = [own[np.isfinite(own)] for own in speed]
    if len(speed) < 3 or not any(map(len, finite)):
        return odd, times
    edges = np.quantile(np.concatenate(finite), np.linspace(0, 1, 21)[1:-1])
    bins = [np.searchsorted(edges, own) for own in speed]
    grid = np.full((len(speed), len(edges) + 1), np.nan)
    for row, own, up in zip(grid, bins, current, strict=True):
        for at in np.unique(own[np.isfinite(up)]):
            row[at] = np.nanmedian(up[own == at])
    largest = max(np.nanmax(np.abs(up), initial=0.0) for up in current)
    for number, (own, up) in enumerate(zip(bins, current, strict=True)):
        others = np.delete(grid, number, axis=0)
        known = (np.isfinite(others).sum(axis=0) > 1) & np.isfinite(grid[number])
        usual = np.full(len(edges) + 1, np.nan)
        usual[known] = np.nanmedian(others[:, known], axis=0)
        away, least = np.abs(up - usual[own]), APART * largest
        odd[number] = (away > (ODD_ONCE - 1) * np.abs(usual[own])) & (away > least)
        all_away = np.abs(grid[number] - usual)[known]
        if len(all_away) and (all_away > np.maximum((ODD - 1) * np.abs(usual[known]), least / 2)).mean() > 0.5:
            odd[number][:] = True
        if odd[number].any():
            times[number] = float(np.nanmedian(up[odd[number]] / usual[own][odd[number]]))
    return odd, times


def _total(found: list[Source], values: list[Array]) -> list[Array]:
    """Return the sum of the latest value of all, at the times of each."""
    sums = [np.zeros(len(source.times)) for source in found]
    for own, each in zip(found, values, strict=True):
        good = np.isfinite(each)
        times, known = own.times[good], np.append(0.0, each[good])
        for source, total in zip(found, sums, strict=True):
            at = np.searchsorted(times, source.times, side="right")
            late = source.times - np.append(-np.inf, times)[at] > 5 * own.every
            total += np.where(late, 0.0, known[at])
    return sums


def packed(data: bytes) -> str:
    """Return bytes as gzip in base64, the same each time."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()


def first_of(source: Source) -> Record:
    """Return bus and ID of a source."""
    return {"bus": source.rows["bus"][0].as_py(), "id": source.rows["id"][0].as_py()}


def _colour(bus: str, number: int | None) -> int:
    """Return the same colour for the same controller in every flight: by the end of its ID, and its bus's number."""
    found = re.search(r"\d+$", bus)
    return ((number or 0) % IDS_OF_A_BUS + IDS_OF_A_BUS * int(found[0] if found else 0)) % COLOURS


def _varies(values: Array) -> bool:
    """Whether it has two values; absent ones are none."""
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and bool((finite != finite[0]).any())


def _partly(column: Column, values: dict[str, list[Array]], marks: dict[str, list[Record | None]]) -> bool:
    """Whether a level line has marks in it."""
    pairs = zip(values[column.name], marks[column.name], strict=True)
    return any(mark is not None and bool(np.isfinite(each).any()) for each, mark in pairs)


def _text(column: Column, value: float) -> str:
    """What an enum's number means."""
    return column.values.get(int(value)) or f"{int(value):#x}, not defined"


def _marks(source: Source, column: Column) -> Record | None:
    """When a reserved count stood in the place of a value, and which; not where it is so all the time."""
    name = f"{column.name}_special"
    if name not in source.rows.schema.names:
        return None
    special = source.rows[name]
    at = np.flatnonzero(special.is_valid().to_numpy())
    if len(at) == len(special) and pc.count_distinct(special).as_py() == 1:
        at = at[:1]
    at = at[:: -(-len(at) // MARKS) or 1]
    if not len(at):
        return None
    return {"x": source.times[at].tolist(), "what": special.take(pa.array(at)).to_pylist()}
