# SPDX-License-Identifier: GPL-2.0-or-later
"""Small multiples, drawn without a script: a row for each controller, a column for each value, one y axis a column."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import Any

import numpy as np

from .matrix import DEGREES, DIGITS, Part
from .series import Array, Source, thin
from .tables import Column

Record = dict[str, Any]
COLUMNS, SAMPLES = 7, 300
WIDTH, HEIGHT = 600, 100  # of a picture, in its own units


def columns(part: Part, named: set[str]) -> list[tuple[Column, Column | None]]:
    """Return the values to show, each with its command: speed, supply, temperatures, and what findings name."""
    measured = part.speed()
    found: list[tuple[Column, Column | None]] = [measured] if measured else []
    found += [(one, None) for one in reversed(part.supply() or ())]
    found += [(one, None) for one in part.fields(*DEGREES)]
    every = (part.message.columns[name] for name in part.values)
    found += [(one, None) for one in every if one.role == "value" and one.name in named]
    known: dict[str, tuple[Column, Column | None]] = {}
    for column, command in found:
        known.setdefault(column.name, (column, command))
    return list(known.values())[:COLUMNS]


class Multiples:
    """The table of small pictures. faults: {controller: [(begin, end)]}, drawn as bands."""

    def __init__(self, sources: Sequence[Record], length: float, faults: dict[int, list[tuple[float, float]]]) -> None:
        """sources: of the page; length: of all, in seconds."""
        self.sources, self.length, self.faults = sources, max(length, 0.001), faults
        self.heads: list[str] = []
        self.rows: dict[int, dict[int, str]] = {}

    def add(self, part: Part, named: set[str]) -> None:
        """Add the columns of a message; named: the fields that findings name, by field."""
        for column, command in columns(part, named):
            lines = [part.values[one.name] for one in (command, column) if one]
            finite = np.concatenate([own[np.isfinite(own)] for line in lines for own in line])
            low, high = float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))
            if low >= high:  # none, or always the same
                continue
            at = len(self.heads)
            unit = f" {html.escape(column.unit)}" if column.unit else ""
            span = f"{_text(low, column)} to {_text(high, column)}{unit}"
            self.heads.append(f"<b>{html.escape(column.title)}</b> <span class=pale>{span}</span>")
            for number, (source, who) in enumerate(zip(part.found, part.whose, strict=True)):
                own = [line[number] for line in lines]
                self.rows.setdefault(self.sources[who]["controller"], {})[at] = self._picture(
                    source, who, own, low, high, column
                )

    def html(self, labels: dict[int, str]) -> str:
        """Return the table; labels: of the controllers, in their order."""
        head = "".join(f"<th>{one}</th>" for one in self.heads)
        lines = [f"<thead><tr><th></th>{head}</tr></thead>"] if self.heads else []
        for who, label in labels.items():
            cells = "".join(f"<td>{self.rows.get(who, {}).get(at, '')}</td>" for at in range(len(self.heads)))
            lead = f"<th><button type=button class=row data-controller={who}>{html.escape(label)}</button></th>"
            lines.append(f"<tr data-controller={who}>{lead}{cells}</tr>" if who in self.rows else "")
        return "".join(lines)

    def _picture(self, source: Source, who: int, lines: list[Array], low: float, high: float, column: Column) -> str:
        """One picture: what was commanded, pale and wide, what was measured, and bands where there was a fault."""
        times, drawn = thin(source, lines, SAMPLES)
        about = self.sources[who]
        bands = "".join(
            f"<rect class=band x='{self._x(begin):.0f}' width='{max(self._x(end - begin), 4):.0f}' height='{HEIGHT}'/>"
            for begin, end in self.faults.get(about["controller"], ())
        )
        paths = [_path([self._x(time) for time in times], line, low, high) for line in drawn]
        kinds = ("told", "own")[-len(paths) :]
        shapes = "".join(f"<path class={kind} d='{path}'/>" for kind, path in zip(kinds, paths, strict=True))
        finite = lines[-1][np.isfinite(lines[-1])]
        ends = f"{_text(finite.min(initial=np.inf), column)} to {_text(finite.max(initial=-np.inf), column)}"
        said = f"{ends} {column.unit}" if len(finite) else "no value"
        label = html.escape(f"{about['label']}, {column.title}: {said}")
        return (
            f"<svg viewBox='0 0 {WIDTH} {HEIGHT}' preserveAspectRatio=none role=img aria-label='{label}' "
            f"data-colour={about['colour']}><title>{label}</title>{bands}{shapes}</svg>"
        )

    def _x(self, seconds: float) -> float:
        return seconds / self.length * WIDTH


def _text(value: float, column: Column) -> str:
    return f"{value:.{DIGITS.get(column.unit, 2)}f}"


def _path(x: list[float], values: Array, low: float, high: float) -> str:
    """A line with gaps where there is no value."""
    y = HEIGHT - 3 - (values - low) / ((high - low) or 1) * (HEIGHT - 6)
    words, is_up = [], True
    for across, down in zip(x, y, strict=True):
        if np.isnan(down):
            is_up = True
            continue
        words.append(f"{'M' if is_up else 'L'}{across:.0f} {down:.0f}")
        is_up = False
    return "".join(words)
