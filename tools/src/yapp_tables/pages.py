# SPDX-License-Identifier: GPL-2.0-or-later
"""What pages are made of: tables, colours, and whole pages without a script, of two runs compared and of a trend."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence

# Sixteen colours of controllers, on a light and on a dark background. Each is at least 3:1 against its background, and
# at least 0.16 apart from each other and from the grey of Commands, in the Oklab space, where people see differences of
# 0.02. The first ones are the furthest apart.
LIGHT = (
    "#026fd7", "#fb1597", "#02400d", "#ab8a41", "#7f13f5", "#039227", "#aa1a0d", "#a3489d",
    "#d91dfc", "#2ca0ac", "#f84713", "#0816d0", "#987efc", "#630580", "#5c0109", "#012868",
)  # fmt: skip
DARK = (
    "#38c5fd", "#d00c98", "#227702", "#f2d710", "#877deb", "#30bd44", "#ee1401", "#fd67f4",
    "#fdcbf8", "#84f8d2", "#fc8c45", "#1d4ffd", "#53fe0a", "#9a0eef", "#905c3f", "#136b94",
)  # fmt: skip
STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; padding: 4px 16px; max-width: 1200px; }
table { border-collapse: collapse; margin: 8px 0 24px; }
th, td { padding: 3px 10px; text-align: left; }
td { border-bottom: 1px solid color-mix(in srgb, currentColor 20%, transparent); }
.number { text-align: right; font-variant-numeric: tabular-nums; }
.worse { color: #d33030; font-weight: 600; } .better { color: #1a8f3c; } .pale { opacity: 0.65; }
svg { width: 260px; height: 70px; vertical-align: middle; }
.before { fill: #7a8794; } .after { fill: #3086e8; } .dot { fill: currentColor; }
.line { stroke: #3086e8; stroke-width: 2; } .sure { stroke: #d33030; stroke-width: 2; }
"""
HEAD = "default-src 'none'; style-src 'unsafe-inline'"


def css() -> str:
    """Return the rules that give each data-colour its --own."""
    both = enumerate(zip(LIGHT, DARK, strict=True))
    rules = [f'[data-colour="{number}"] {{ --own: light-dark({light}, {dark}); }}' for number, (light, dark) in both]
    return "\n".join(rules)


def html_table(heads: Mapping[str, str], rows: Sequence[Mapping[str, object]]) -> str:
    """Return a table; a column without a cell is left out. heads: {key of the rows: its heading}."""
    keys = [key for key in heads if any(row.get(key) is not None for row in rows)]
    lines = ["".join(_cell("td", row.get(key)) for key in keys) for row in rows]
    return _rows("thead", ["".join(_cell("th", heads[key]) for key in keys)]) + _rows("tbody", lines)


def _rows(tag: str, lines: Iterable[str]) -> str:
    return f"<{tag}>{''.join(f'<tr>{line}</tr>' for line in lines)}</{tag}>"


def _cell(tag: str, value: object) -> str:
    text = f"{value:.7g}" if isinstance(value, float) else "" if value is None else html.escape(str(value))
    return f"<{tag} class=number>{text}</{tag}>" if isinstance(value, int | float) else f"<{tag}>{text}</{tag}>"


def page(title: str, parts: Iterable[str]) -> str:
    """Return a page that opens offline and asks the network for nothing."""
    return (
        f"<!doctype html>\n<html lang=en><head><meta charset=utf-8>"
        f'<meta http-equiv="Content-Security-Policy" content="{HEAD}">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>\n<h1>{html.escape(title)}</h1>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def listed(lines: Sequence[tuple[str, str]]) -> str:
    """Return (class, text) lines as a list."""
    items = (f"<li class={kind or 'plain'}>{html.escape(text)}</li>" for kind, text in lines)
    return f"<ul>{''.join(items)}</ul>"


def pairs(rows: Sequence[tuple[str, tuple[float, float], tuple[float, float]]], unit: str, head: str) -> str:
    """Return a table of bins, (label, (mean, spread) BEFORE, (mean, spread) AFTER), with bars side by side."""
    heads = {"label": head, "before": f"BEFORE, {unit}", "after": f"AFTER, {unit}", "change": "change"}
    cells = [
        {"label": label, "before": f"{one[0]:.4g} ± {one[1]:.2g}", "after": f"{other[0]:.4g} ± {other[1]:.2g}",
         "change": f"{other[0] - one[0]:+.3g} {unit}"}
        for label, one, other in rows
    ]  # fmt: skip
    most = max(max(abs(one[0]), abs(other[0])) for _, one, other in rows) or 1.0
    wide = 260 / len(rows)
    bars = "".join(
        f"<rect class={kind} x='{at * wide + shift * wide * 0.4:.1f}' y='{70 - 66 * abs(value) / most:.1f}' "
        f"width='{wide * 0.38:.1f}' height='{66 * abs(value) / most:.1f}'/>"
        for at, (_, one, other) in enumerate(rows)
        for shift, kind, value in ((0, "before", one[0]), (1, "after", other[0]))
    )
    label = html.escape(f"bars of {len(rows)} bins, BEFORE beside AFTER")
    return (
        f"<table>{html_table(heads, cells)}</table><svg viewBox='0 0 260 70' role=img aria-label='{label}'>{bars}</svg>"
    )


def dots(values: Sequence[float], line: tuple[float, float] | None, label: str, is_sure: bool) -> str:
    """Return a picture of values over flights, with a line from its first to its last value."""
    ends = [*values, *(line or ())]
    low, high = min(ends), max(ends)
    span = (high - low) or 1.0

    def place(at: float, value: float) -> tuple[str, str]:
        return f"{4 + 252 * at / max(len(values) - 1, 1):.1f}", f"{64 - 58 * (value - low) / span:.1f}"

    shapes = ""
    for at, value in enumerate(values):
        x, y = place(at, value)
        shapes += f"<circle class=dot cx={x} cy={y} r=1.8 />"
    if line:
        (x, y), (to_x, to_y) = place(0, line[0]), place(len(values) - 1, line[1])
        shapes += f"<line class={'sure' if is_sure else 'line'} x1={x} y1={y} x2={to_x} y2={to_y} />"
    about = html.escape(label)
    return f"<svg viewBox='0 0 260 70' role=img aria-label='{about}'><title>{about}</title>{shapes}</svg>"
