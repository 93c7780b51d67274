# SPDX-License-Identifier: GPL-2.0-or-later
"""Controllers beside each other: a matrix of measures, in which the odd one is seen at once, and small multiples."""

import html
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .differs import Found, Windows
from .series import DEGREES, LATE, Array, Samples, thin
from .tshark import Record

DIGITS = {"°C": 0, "V": 2, "A": 2, "W": 0, "RPM": 0, "Wh": 1, "Ah": 3}  # behind the point
SAG = 10  # seconds: a voltage is compared with its highest of so long before
# How many times as far from the others' median as they usually are, for each shade.
SHADES = (4.0, 8.0, 16.0)
# The least distance that counts as usual: a share of the median, and an amount.
USUAL = 0.02
LEAST = {"°C": 1.0, "": 0.1, "V": 0.05, "A": 0.1, "W": 1.0, "RPM": 1.0}
COLUMNS, SAMPLES = 7, 300  # of the small multiples
WIDTH, HEIGHT = 600, 100  # of a picture, in its own units


class Matrix:
    """Measures of all controllers. cells: {(title, unit, field whose picture shows more): {controller: value}}."""

    def __init__(self, messages: Sequence[Found], sources: Sequence[Record]) -> None:
        """sources: of the page, each with its controller."""
        self.sources, self.messages = sources, messages
        self.cells: dict[tuple[str, str, str], dict[int, float]] = {}
        # A message that is sent to all controllers of a bus, such as a command, is none of one.
        leads = [found for found in messages if found[0].speed() or found[0].supply()] or list(messages[:1])
        last = {id(one): max(other.times[-1] for other in found) for found in leads for one in found}
        leading = [one for found in leads for one in found]
        self.silent = {self.whose(one) for one in leading if last[id(one)] - one.times[-1] > LATE * one.every}
        self.labels: dict[int, str] = {}
        for one in leading:
            self.labels.setdefault(self.whose(one), sources[one.number]["label"])

    def whose(self, one: Samples) -> int:
        """Return the controller of a source."""
        return int(self.sources[one.number]["controller"])

    def count(self, title: str, rows: Sequence[Record]) -> None:
        """Count events, {number: of the source on the page}, of each controller."""
        counts = Counter(self.sources[row["number"]]["controller"] for row in rows)
        self.cells[title, "", ""] = {who: float(counts[who]) for who in self.labels}

    def measure(self) -> None:
        """Measure what the values tell. Means are of the flight."""
        for one in (one for found in self.messages for one in found if self.whose(one) in self.labels):
            for name in one.measured(*DEGREES):
                self._add(one, name, "max", "°C", one.columns[name], np.nanmax)
            if pair := one.supply():
                volts, amperes = (one.columns[name] for name in pair)
                watts, gaps = volts * amperes, np.diff(one.times)
                hours = np.where(gaps > LATE * one.every, 0.0, gaps) / 3600  # nothing counts where nothing came
                energy, charge = ((values[1:] + values[:-1]) / 2 * hours for values in (watts, amperes))
                self._add(one, pair[1], "mean", "A", np.where(one.flying, amperes, np.nan), np.nanmean)
                self._add(one, pair[1], "peak", "A", amperes, np.nanmax)
                self._add(one, pair[1], "power peak", "W", watts, np.nanmax)
                self._add(one, pair[1], "energy", "Wh", energy, np.nansum)
                self._add(one, pair[1], "charge", "Ah", charge, np.nansum)
                # How far a value lies below the highest of the last seconds.
                size, known = max(1, round(SAG / one.every)), np.where(np.isfinite(volts), volts, -np.inf)
                padded = np.concatenate([np.full(size - 1, -np.inf), known])
                highest = np.lib.stride_tricks.sliding_window_view(padded, size).max(axis=1)
                self._add(one, pair[0], "sag", "V", highest - volts, np.nanmax)
            if pair := one.speed():
                error = np.where(one.flying, np.abs(one.columns[pair[0]] - one.columns[pair[1]]), np.nan)
                self._add(one, pair[0], "error mean", one.unit_of(pair[0]), error, np.nanmean)

    def _add(self, one: Samples, name: str, what: str, unit: str, values: Array, measure: Any) -> None:
        """Measure a value of a source; nothing where it never had one."""
        if np.isfinite(values).any():
            title = f"{one.title_of(name)} {what}" if unit not in ("Ah", "Wh", "W") else what.capitalize()
            cells = self.cells.setdefault((title, unit, f"{one.message}.{name}"), {})
            cells[self.whose(one)] = float(measure(values))

    def html(self) -> str:
        """Return it as a table; a click on a row shows the lines of this controller only."""
        titles = (f"{title}, {unit}" if unit else title for title, unit, _ in self.cells)
        heads = "".join(f"<th>{html.escape(title)}</th>" for title in titles)
        lines = [f"<thead><tr><th>controller</th>{heads}</tr></thead>"]
        for who, label in self.labels.items():
            # The mean of a part of the flight is no measure of the controller.
            cells = [_cell(values, unit, figure, who, who in self.silent and title.endswith("mean"))
                     for (title, unit, figure), values in self.cells.items()]  # fmt: skip
            lines.append(_line(who, label, cells))
        return "".join(lines)

    def multiples(self, length: float, faults: Mapping[int, Sequence[tuple[float, float]]], named: set[str]) -> str:
        """Return a table of small pictures without a script: a row a controller, a column a value, one y axis a column.

        length: of the flight, in seconds; faults: {controller: [(begin, end)]}, drawn as bands; named: the fields that
        findings name.
        """
        columns: list[tuple[str, dict[int, str]]] = []  # heading, and the picture of each controller
        for found in self.messages:
            lead, pair = found[0], found[0].speed()
            shown = [*(pair or ())[:1], *reversed(lead.supply() or ()), *lead.measured(*DEGREES)]
            shown += [name for name in lead.names("value") if name in named]
            for name in list(dict.fromkeys(shown))[:COLUMNS]:
                drawn = [pair[1], name] if pair and name == pair[0] else [name]
                values = np.concatenate([one.columns[each] for one in found for each in drawn])
                ends = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
                if ends[0] < ends[1]:
                    head = f"<b>{html.escape(lead.title_of(name))}</b> "
                    head += f"<span class=pale>{_span(lead, name, values)}</span>"
                    columns.append((head, {}))
                    for one in found:
                        who, about = self.whose(one), self.sources[one.number]
                        bands = faults.get(who, ())
                        columns[-1][1][who] = _picture(one, about, drawn, ends, bands, WIDTH / length)
        heads = "".join(f"<th>{head}</th>" for head, _ in columns)
        lines = [f"<thead><tr><th></th>{heads}</tr></thead>"] if heads else []
        for who, label in self.labels.items():
            cells = [pictures.get(who, "") for _, pictures in columns]
            lines += [_line(who, label, [f"<td>{cell}</td>" for cell in cells])] if any(cells) else []
        return "".join(lines)


def _line(who: int, label: str, cells: Sequence[str]) -> str:
    lead = f"<th><button type=button class=row data-controller={who}>{html.escape(label)}</button></th>"
    return f"<tr data-controller={who}>{lead}{''.join(cells)}</tr>"


def _cell(values: Mapping[int, float], unit: str, figure: str, who: int, is_plain: bool) -> str:
    """One value, with a shade where it is far from the others, unless it is plain, and an arrow that says which way."""
    if who not in values:
        return "<td></td>"
    value = values[who]
    others = np.array([other for one, other in values.items() if one != who])
    text, shade, title = f"{value:.{DIGITS.get(unit, 0)}f}", 0, ""
    if len(others) > 1 and not is_plain:
        middle = float(np.median(others))
        apart = 1.5 * float(np.median(np.abs(others - middle)))
        usual = max(apart, USUAL * abs(middle), LEAST.get(unit, 0.001))
        # Where several are alike, on one bus for example, none of them is the odd one.
        beside = sum(abs(others - value) < abs(value - middle) / 2)
        shade = sum(abs(value - middle) / usual >= step for step in SHADES) if beside <= (len(others) > 5) else 0
        title = f"the median of the others is {middle:.4g} {unit}".rstrip()
        text = f"{'▲' if value > middle else '▼'} {text}" if shade else text
    about = f" class='number far{shade}'" if shade else " class=number"
    return f"<td{about} data-figure='{html.escape(figure)}' title='{html.escape(title)}'>{text}</td>"


def _span(one: Samples, name: str, values: Array) -> str:
    digits = DIGITS.get(one.unit_of(name), 2)
    known = values[np.isfinite(values)]
    span = f"{known.min():.{digits}f} to {known.max():.{digits}f} {one.unit_of(name)}" if len(known) else "no value"
    return html.escape(span.strip())


def _picture(
    one: Samples, source: Record, names: list[str], ends: tuple[float, float], bands: Windows, scale: float
) -> str:
    """One picture: what was commanded, pale and wide, what was measured, bands of faults; scale: of a second."""
    times, lines = thin(one, [one.columns[name] for name in names], SAMPLES)
    shapes = ""
    for begin, end in bands:
        wide = max((end - begin) * scale, 4)
        shapes += f"<rect class=band x='{begin * scale:.0f}' width='{wide:.0f}' height='{HEIGHT}'/>"
    for kind, values in zip(("told", "own")[-len(lines) :], lines, strict=True):
        y = HEIGHT - 3 - (values - ends[0]) / (ends[1] - ends[0]) * (HEIGHT - 6)
        is_first = np.isnan(np.concatenate([[np.nan], y[:-1]]))  # a line has a gap where there is no value
        words = (f"{'M' if first else 'L'}{across:.0f} {down:.0f}" for across, down, first
                 in zip(times * scale, y, is_first, strict=True) if down == down)  # fmt: skip
        shapes += f"<path class={kind} d='{''.join(words)}'/>"
    label = html.escape(f"{source['label']}, {one.title_of(names[-1])}")
    label += f": {_span(one, names[-1], one.columns[names[-1]])}"
    return (
        f"<svg viewBox='0 0 {WIDTH} {HEIGHT}' preserveAspectRatio=none role=img aria-label='{label}' "
        f"data-colour={source['colour']}><title>{label}</title>{shapes}</svg>"
    )
