# SPDX-License-Identifier: GPL-2.0-or-later
"""What pages are made of: tables, colours, and whole pages without a script, of two runs compared and of a trend."""

import html
from collections.abc import Iterable, Sequence

import numpy as np

from .series import Array

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
.dot { fill: currentColor; }
.line { stroke: #3086e8; stroke-width: 2; } .sure { stroke: #d33030; stroke-width: 2; }
"""
HEAD = "default-src 'none'; style-src 'unsafe-inline'"


def css() -> str:
    """Return the rules that give each data-colour its --own."""
    both = enumerate(zip(LIGHT, DARK, strict=True))
    rules = [f'[data-colour="{number}"] {{ --own: light-dark({light}, {dark}); }}' for number, (light, dark) in both]
    return "\n".join(rules)


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


def pairs(rows: Sequence[tuple[str, tuple[float, float], tuple[float, float]]], unit: str) -> str:
    """Return a table of bins side by side: (range of speed, (mean, spread) BEFORE, (mean, spread) AFTER).

    Behind each mean stands a bar as long as it is.
    """
    most = max(max(abs(one[0]), abs(other[0])) for _, one, other in rows) or 1.0
    lines = [f"<tr><th>speed, RPM</th><th>BEFORE, {unit}</th><th>AFTER, {unit}</th><th>change, {unit}</th></tr>"]
    for label, *both in rows:
        cells = "".join(
            f"<td><meter max={most:.6g} value={abs(mean):.6g}></meter> {mean:.4g} ± {spread:.2g}</td>"
            for mean, spread in both
        )
        lines.append(f"<tr><td>{label}</td>{cells}<td class=number>{both[1][0] - both[0][0]:+.3g}</td></tr>")
    return f"<table>{''.join(lines)}</table>"


def dots(values: Array, slope: float, label: str, is_sure: bool) -> str:
    """Return a picture of values over flights, with a line of this slope through their middle."""
    at = np.arange(len(values))
    line = np.median(values - slope * at) + slope * at[[0, -1]]
    low, high = min(*values, *line), max(*values, *line)
    across = 4 + 252 * at / (len(values) - 1)
    down, (left, right) = (64 - 58 * (each - low) / ((high - low) or 1.0) for each in (values, line))
    shapes = "".join(f"<circle class=dot cx={x:.1f} cy={y:.1f} r=1.8 />" for x, y in zip(across, down, strict=True))
    shapes += f"<line class={'sure' if is_sure else 'line'} x1=4 y1={left:.1f} x2=256 y2={right:.1f} />"
    about = html.escape(label)
    return f"<svg viewBox='0 0 260 70' role=img aria-label='{about}'><title>{about}</title>{shapes}</svg>"
