# SPDX-License-Identifier: GPL-2.0-or-later
"""Pages without a script, of two runs compared and of a trend: page.html, lists, tables and small pictures."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from .series import Array


def page(title: str, parts: Iterable[str]) -> str:
    """Return a page that opens offline and asks the network for nothing."""
    template = Path(__file__).with_name("page.html").read_text(encoding="utf-8")
    return template.replace("/*TITLE*/", html.escape(title)).replace("/*PARTS*/", "\n".join(parts))


def listed(lines: Sequence[tuple[str, str]]) -> str:
    """Return (class, text) lines as a list."""
    items = (f"<li class={kind or 'plain'}>{html.escape(text)}</li>" for kind, text in lines)
    return f"<ul>{''.join(items)}</ul>"


def pairs(rows: Sequence[tuple[str, tuple[float, float], tuple[float, float]]], unit: str) -> str:
    """Return a table of bins side by side: (range of speed, (mean, spread) BEFORE, (mean, spread) AFTER)."""
    most = max(max(abs(one[0]), abs(other[0])) for _, one, other in rows) or 1.0
    lines = [f"<tr><th>speed, RPM</th><th>BEFORE, {unit}</th><th>AFTER, {unit}</th><th>change, {unit}</th></tr>"]
    for label, *both in rows:
        lines.append(f"<tr><td>{label}</td>")
        for mean, spread in both:
            bar = f"<meter max={most:.6g} value={abs(mean):.6g}></meter>"
            lines.append(f"<td>{bar} {mean:.4g} ± {spread:.2g}</td>")
        lines.append(f"<td class=number>{both[1][0] - both[0][0]:+.3g}</td></tr>")
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
