# SPDX-License-Identifier: GPL-2.0-or-later
"""A matrix, controller by value, in which the one that is far from the others is seen at once."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from .limits import Limits, minutes_left
from .series import LATE, Array, Source
from .tables import Column, Message

Record = dict[str, Any]
DEGREES = ("°C", "C", "degC")
DIGITS = {"°C": 0, "V": 2, "A": 2, "W": 0, "RPM": 0, "Wh": 1, "Ah": 3, "min": 1}  # behind the point
SAG = 10  # seconds: a voltage is compared with its highest of so long before
# How many times as far from the others' median as they usually are, for each shade.
SHADES = (4.0, 8.0, 16.0)
# The least distance that counts as usual: a share of the median, and an amount.
USUAL = 0.02
LEAST = {"°C": 1.0, "": 0.1, "min": 1.0, "V": 0.05, "A": 0.1, "W": 1.0, "RPM": 1.0}


@dataclass
class Part:
    """One message of a flight. found: its sources; whose: their numbers on the page; values: those of each field.

    flying, calm: of each source, which samples are of the flight, and which of these can be compared.
    """

    message: Message
    found: list[Source]
    whose: list[int]
    values: dict[str, list[Array]]
    flying: list[Array] = field(default_factory=list)
    calm: list[Array] = field(default_factory=list)

    def fields(self, *units: str) -> list[Column]:
        """Return the values that have one of these units and were measured."""
        known = (self.message.columns[name] for name in self.values)
        return [
            one for one in known if one.role == "value" and one.unit in units and not one.name.endswith("commanded")
        ]

    def silent(self) -> list[int]:
        """Return the numbers of the sources that fell silent while another one went on."""
        last = max(source.times[-1] for source in self.found)
        both = zip(self.found, self.whose, strict=True)
        return [who for source, who in both if last - source.times[-1] > LATE * source.every]

    def supply(self) -> tuple[Column, Column] | None:
        """Return voltage and current of the supply: of all in V and A, the two whose names begin alike."""
        pairs = [(volts, amperes) for volts in self.fields("V") for amperes in self.fields("A")]
        return next((pair for pair in pairs if len({one.name.partition("_")[0] for one in pair}) == 1), None)

    def speed(self) -> tuple[Column, Column] | None:
        """Return what follows a command, and the command; of several the last: a speed stands behind a torque."""
        names = [name for name in self.values if name.replace("_measured", "_commanded") in self.values]
        names = [name for name in names if name.endswith("_measured")]
        pairs = [(self.message.columns[name], name.replace("_measured", "_commanded")) for name in names]
        return next(((one, self.message.columns[command]) for one, command in reversed(pairs)), None)


@dataclass
class Measure:
    """A column of the matrix. figure: the field whose picture shows more; cells: {controller: value}."""

    title: str
    unit: str
    figure: str = ""
    cells: dict[int, float] = field(default_factory=dict)


class Matrix:
    """Measures of all controllers, from the parts of a page."""

    def __init__(self, parts: Sequence[Part], sources: Sequence[Record], limits: Limits) -> None:
        """sources: of the page, each with its controller."""
        self.parts, self.sources, self.limits = parts, sources, limits
        self.measures: dict[tuple[str, str], Measure] = {}
        # A message that is sent to all controllers of a bus, such as a command, is none of one.
        leads = [part for part in parts if part.speed() or part.supply()] or list(parts[:1])
        self.silent = {sources[who]["controller"] for part in leads for who in part.silent()}
        self.labels: dict[int, str] = {}
        for source in (sources[who] for part in leads for who in part.whose):
            self.labels.setdefault(source["controller"], source["label"])

    def measure(self) -> None:
        """Measure what the values tell."""
        for part in self.parts:
            self._add(part)

    def count(self, title: str, rows: Sequence[Record]) -> None:
        """Count events, {source: number on the page}, of each controller."""
        measure = self.measures.setdefault((title, ""), Measure(title, ""))
        measure.cells = dict.fromkeys(self.labels, 0.0)
        for row in rows:
            who = self.sources[row["number"]]["controller"]
            if who in measure.cells:
                measure.cells[who] += row.get("count", 1)

    def _add(self, part: Part) -> None:
        for column in part.fields(*DEGREES):
            self._each(part, column, "max", "°C", _largest)
            highs = [self.limits.of(source.name, part.message.name, column.name)[1] for source in part.found]
            by_name = dict(zip((source.name for source in part.found), highs, strict=True))
            self._each(part, column, "minutes left", "min", partial(_left, by_name))
        if pair := part.supply():
            volts, amperes = pair
            self._each(part, amperes, "mean", "A", _mean)
            self._each(part, amperes, "peak", "A", _largest)
            powers = [u * i for u, i in zip(part.values[volts.name], part.values[amperes.name], strict=True)]
            self._each(part, amperes, "power peak", "W", _largest, powers)
            self._each(part, amperes, "energy", "Wh", _integral, powers)
            self._each(part, amperes, "charge", "Ah", _integral)
            self._each(part, volts, "sag", "V", _sag)
        if pair := part.speed():
            measured, command = pair
            both = zip(part.values[measured.name], part.values[command.name], strict=True)
            errors = [np.abs(own - told) for own, told in both]
            self._each(part, measured, "error mean", measured.unit, _mean, errors)

    def _each(
        self,
        part: Part,
        column: Column,
        what: str,
        unit: str,
        measure: Callable[[Source, Array], float | None],
        values: list[Array] | None = None,
    ) -> None:
        """Measure a value of each source; none where it never had one."""
        values = part.values[column.name] if values is None else values
        if what in ("mean", "error mean", "minutes left"):  # of the flight
            values = [np.where(use, own, np.nan) for use, own in zip(part.flying, values, strict=True)]
        for source, who, own in zip(part.found, part.whose, values, strict=True):
            controller = self.sources[who]["controller"]
            value = measure(source, own) if np.isfinite(own).any() and controller in self.labels else None
            if value is not None:
                title = f"{column.title} {what}" if unit not in ("Ah", "Wh", "W") else what.capitalize()
                made = Measure(title, unit, f"{part.message.name}.{column.name}")
                self.measures.setdefault((title, unit), made).cells[controller] = float(value)

    def html(self) -> str:
        """Return it as a table; a click on a row shows the lines of this controller only."""
        measures = [one for one in self.measures.values() if one.cells]
        heads = "".join(
            f"<th>{html.escape(one.title)}{f', {html.escape(one.unit)}' * bool(one.unit)}</th>" for one in measures
        )
        lines = [f"<thead><tr><th>controller</th>{heads}</tr></thead>"]
        for who, label in self.labels.items():
            # The mean of a part of the flight is no measure of the controller.
            cells = "".join(_cell(one, who, who in self.silent and one.title.endswith("mean")) for one in measures)
            lead = f"<th><button type=button class=row data-controller={who}>{html.escape(label)}</button></th>"
            lines.append(f"<tr data-controller={who}>{lead}{cells}</tr>")
        return "".join(lines)


def _cell(measure: Measure, who: int, is_plain: bool = False) -> str:
    """One value, with a shade where it is far from the others, unless it is plain, and an arrow that says which way."""
    if who not in measure.cells:
        return "<td></td>"
    value = measure.cells[who]
    others = np.array([other for one, other in measure.cells.items() if one != who])
    text, shade, title = f"{value:.{DIGITS.get(measure.unit, 0)}f}", 0, ""
    if len(others) > 1 and not is_plain:
        middle = float(np.median(others))
        usual = max(
            1.5 * float(np.median(np.abs(others - middle))), USUAL * abs(middle), LEAST.get(measure.unit, 0.001)
        )
        # Where several are alike, on one bus for example, none of them is the odd one.
        beside = sum(abs(others - value) < abs(value - middle) / 2)
        shade = sum(abs(value - middle) / usual >= step for step in SHADES) if beside <= (len(others) > 5) else 0
        title = f"the median of the others is {middle:.4g} {measure.unit}".rstrip()
        text = f"{'▲' if value > middle else '▼'} {text}" if shade else text
    about = f" class='number far{shade}'" if shade else " class=number"
    return f"<td{about} data-figure='{html.escape(measure.figure)}' title='{html.escape(title)}'>{text}</td>"


def _largest(_: Source, values: Array) -> float:
    return float(np.nanmax(values))


def _mean(_: Source, values: Array) -> float:
    return float(np.nanmean(values))


def _left(limits: dict[str, float], source: Source, values: Array) -> float | None:
    return minutes_left(source, values, limits[source.name])


def _integral(source: Source, values: Array) -> float:
    """Return the value over the time in hours; nothing counts where nothing came."""
    steps = np.diff(source.times)
    steps[steps > LATE * source.every] = 0
    return float(np.nansum((values[1:] + values[:-1]) / 2 * steps) / 3600)


def _sag(source: Source, values: Array) -> float:
    """Return the largest step down from the highest value of the last seconds."""
    size = max(1, round(SAG / source.every))
    filled = np.where(np.isfinite(values), values, -np.inf)
    padded = np.concatenate([np.full(size - 1, -np.inf), filled])
    highest = np.lib.stride_tricks.sliding_window_view(padded, size).max(axis=1)
    return float(np.nanmax(highest - values))
