# SPDX-License-Identifier: GPL-2.0-or-later
"""Controllers beside each other: a matrix of measures, in which the odd one is seen at once, and small multiples."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .series import DEGREES, LATE, Array, Samples, thin

Record = dict[str, Any]
DIGITS = {"°C": 0, "V": 2, "A": 2, "W": 0, "RPM": 0, "Wh": 1, "Ah": 3}  # behind the point
SAG = 10  # seconds: a voltage is compared with its highest of so long before
# How many times as far from the others' median as they usually are, for each shade.
SHADES = (4.0, 8.0, 16.0)
# The least distance that counts as usual: a share of the median, and an amount.
USUAL = 0.02
LEAST = {"°C": 1.0, "": 0.1, "V": 0.05, "A": 0.1, "W": 1.0, "RPM": 1.0}
COLUMNS, SAMPLES = 7, 300  # of the small multiples
WIDTH, HEIGHT = 600, 100  # of a picture, in its own units
Found = Sequence[Samples]  # one message of all sources


@dataclass
class Measure:
    """A column of the matrix. figure: the field whose picture shows more; cells: {controller: value}."""

    title: str
    unit: str
    figure: str = ""
    cells: dict[int, float] = field(default_factory=dict)


class Matrix:
    """Measures of all controllers."""

    def __init__(self, messages: Sequence[Found], sources: Sequence[Record]) -> None:
        """sources: of the page, each with its controller."""
        self.sources, self.messages = sources, messages
        self.measures: dict[tuple[str, str], Measure] = {}
        # A message that is sent to all controllers of a bus, such as a command, is none of one.
        leads = [found for found in messages if found[0].speed() or found[0].supply()] or list(messages[:1])
        self.silent = {
            sources[one.number]["controller"]
            for found in leads
            for one in found
            if max(other.times[-1] for other in found) - one.times[-1] > LATE * one.every
        }
        self.labels: dict[int, str] = {}
        for source in (sources[one.number] for found in leads for one in found):
            self.labels.setdefault(source["controller"], source["label"])

    def count(self, title: str, rows: Sequence[Record]) -> None:
        """Count events, {number: of the source on the page}, of each controller."""
        measure = self.measures.setdefault((title, ""), Measure(title, ""))
        measure.cells = dict.fromkeys(self.labels, 0.0)
        for row in rows:
            who = self.sources[row["number"]]["controller"]
            if who in measure.cells:
                measure.cells[who] += row.get("count", 1)

    def measure(self) -> None:
        """Measure what the values tell. Means are of the flight."""
        for one in (one for found in self.messages for one in found):
            for name in one.measured(*DEGREES):
                self._add(one, name, "max", "°C", one.columns[name], np.nanmax)
            if pair := one.supply():
                volts, amperes = (one.columns[name] for name in pair)
                watts, hours = volts * amperes, _hours(one)
                self._add(one, pair[1], "mean", "A", np.where(one.flying, amperes, np.nan), np.nanmean)
                self._add(one, pair[1], "peak", "A", amperes, np.nanmax)
                self._add(one, pair[1], "power peak", "W", watts, np.nanmax)
                self._add(one, pair[1], "energy", "Wh", _between(watts) * hours, np.nansum)
                self._add(one, pair[1], "charge", "Ah", _between(amperes) * hours, np.nansum)
                self._add(one, pair[0], "sag", "V", _sags(one, volts), np.nanmax)
            if pair := one.speed():
                error = np.abs(one.columns[pair[0]] - one.columns[pair[1]])
                self._add(
                    one, pair[0], "error mean", one.unit_of(pair[0]), np.where(one.flying, error, np.nan), np.nanmean
                )

    def _add(self, one: Samples, name: str, what: str, unit: str, values: Array, measure: Any) -> None:
        """Measure a value of a source; nothing where it never had one."""
        controller = self.sources[one.number]["controller"]
        if np.isfinite(values).any() and controller in self.labels:
            title = f"{one.title_of(name)} {what}" if unit not in ("Ah", "Wh", "W") else what.capitalize()
            made = Measure(title, unit, f"{one.message}.{name}")
            self.measures.setdefault((title, unit), made).cells[controller] = float(measure(values))

    def html(self) -> str:
        """Return it as a table; a click on a row shows the lines of this controller only."""
        measures = [one for one in self.measures.values() if one.cells]
        heads = "".join(
            f"<th>{html.escape(one.title)}{f', {html.escape(one.unit)}' * bool(one.unit)}</th>" for one in measures
        )
        lines = [f"<thead><tr><th>controller</th>{heads}</tr></thead>"]
        for who, label in self.labels.items():
            # The mean of a part of the flight is no measure of the controller.
            cells = [_cell(one, who, who in self.silent and one.title.endswith("mean")) for one in measures]
            lines.append(_line(who, label, cells))
        return "".join(lines)


def _line(who: int, label: str, cells: Sequence[str]) -> str:
    lead = f"<th><button type=button class=row data-controller={who}>{html.escape(label)}</button></th>"
    return f"<tr data-controller={who}>{lead}{''.join(cells)}</tr>"


def _cell(measure: Measure, who: int, is_plain: bool = False) -> str:
    """One value, with a shade where it is far from the others, unless it is plain, and an arrow that says which way."""
    if who not in measure.cells:
        return "<td></td>"
    value = measure.cells[who]
    others = np.array([other for one, other in measure.cells.items() if one != who])
    text, shade, title = f"{value:.{DIGITS.get(measure.unit, 0)}f}", 0, ""
    if len(others) > 1 and not is_plain:
        middle = float(np.median(others))
        apart, least = 1.5 * float(np.median(np.abs(others - middle))), LEAST.get(measure.unit, 0.001)
        usual = max(apart, USUAL * abs(middle), least)
        # Where several are alike, on one bus for example, none of them is the odd one.
        beside = sum(abs(others - value) < abs(value - middle) / 2)
        shade = sum(abs(value - middle) / usual >= step for step in SHADES) if beside <= (len(others) > 5) else 0
        title = f"the median of the others is {middle:.4g} {measure.unit}".rstrip()
        text = f"{'▲' if value > middle else '▼'} {text}" if shade else text
    about = f" class='number far{shade}'" if shade else " class=number"
    return f"<td{about} data-figure='{html.escape(measure.figure)}' title='{html.escape(title)}'>{text}</td>"


def _between(values: Array) -> Array:
    return (values[1:] + values[:-1]) / 2


def _hours(one: Samples) -> Array:
    """Return the time between two messages in hours; nothing counts where nothing came."""
    return np.where(np.diff(one.times) > LATE * one.every, 0.0, np.diff(one.times)) / 3600


def _sags(one: Samples, values: Array) -> Array:
    """Return how far each value lies below the highest of the last seconds."""
    size = max(1, round(SAG / one.every))
    padded = np.concatenate([np.full(size - 1, -np.inf), np.where(np.isfinite(values), values, -np.inf)])
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, size).max(axis=1) - values)


# ---- small multiples, drawn without a script: a row a controller, a column a value, one y axis a column


def multiples(
    messages: Sequence[Found],
    matrix: Matrix,
    length: float,
    faults: Mapping[int, Sequence[tuple[float, float]]],
    named: set[str],
) -> str:
    """Return the table. length: of the flight, in seconds; faults: {controller: [(begin, end)]}, drawn as bands;
    named: the fields that findings name."""
    heads: list[str] = []
    rows: dict[int, dict[int, str]] = {}
    for found in messages:
        lead = found[0]
        shown = [*(lead.speed() or ())[:1], *reversed(lead.supply() or ()), *lead.measured(*DEGREES)]
        shown += [name for name in lead.names("value") if name in named]
        for name in list(dict.fromkeys(shown))[:COLUMNS]:
            pair = lead.speed()
            drawn = [pair[1], name] if pair and name == pair[0] else [name]
            values = np.concatenate([one.columns[each] for one in found for each in drawn])
            if np.isfinite(values).any() and np.nanmin(values) < np.nanmax(values):
                ends = float(np.nanmin(values)), float(np.nanmax(values))
                heads.append(
                    f"<b>{html.escape(lead.title_of(name))}</b> <span class=pale>{_span(lead, name, ends)}</span>"
                )
                for one in found:
                    source = matrix.sources[one.number]
                    bands = faults.get(source["controller"], ())
                    picture = _picture(one, source, drawn, ends, bands, WIDTH / max(length, 0.001))
                    rows.setdefault(source["controller"], {})[len(heads)] = picture
    lines = [f"<thead><tr><th></th>{''.join(f'<th>{head}</th>' for head in heads)}</tr></thead>"] if heads else []
    for who, label in matrix.labels.items():
        if who in rows:
            lines.append(_line(who, label, [f"<td>{rows[who].get(at + 1, '')}</td>" for at in range(len(heads))]))
    return "".join(lines)


def _span(one: Samples, name: str, ends: tuple[float, float]) -> str:
    digits = DIGITS.get(one.unit_of(name), 2)
    return html.escape(f"{ends[0]:.{digits}f} to {ends[1]:.{digits}f} {one.unit_of(name)}".strip())


def _picture(
    one: Samples,
    source: Record,
    names: Sequence[str],
    ends: tuple[float, float],
    bands: Sequence[tuple[float, float]],
    scale: float,
) -> str:
    """One picture: what was commanded, pale and wide, what was measured, and bands where there was a fault."""
    times, lines = thin(one, [one.columns[name] for name in names], SAMPLES)
    shapes = "".join(
        f"<rect class=band x='{begin * scale:.0f}' width='{max((end - begin) * scale, 4):.0f}' height='{HEIGHT}'/>"
        for begin, end in bands
    )
    for kind, values in zip(("told", "own")[-len(lines) :], lines, strict=True):
        y = HEIGHT - 3 - (values - ends[0]) / (ends[1] - ends[0]) * (HEIGHT - 6)
        is_first = np.isnan(np.concatenate([[np.nan], y[:-1]]))  # a line has a gap where there is no value
        words = (f"{'M' if first else 'L'}{across:.0f} {down:.0f}"
                 for across, down, first in zip(times * scale, y, is_first, strict=True) if down == down)  # fmt: skip
        shapes += f"<path class={kind} d='{''.join(words)}'/>"
    own = one.columns[names[-1]]
    is_there = np.isfinite(own).any()
    said = _span(one, names[-1], (float(np.nanmin(own)), float(np.nanmax(own)))) if is_there else "no value"
    label = html.escape(f"{source['label']}, {one.title_of(names[-1])}") + f": {said}"
    return (
        f"<svg viewBox='0 0 {WIDTH} {HEIGHT}' preserveAspectRatio=none role=img aria-label='{label}' "
        f"data-colour={source['colour']}><title>{label}</title>{shapes}</svg>"
    )
