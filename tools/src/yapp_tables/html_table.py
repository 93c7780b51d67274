# SPDX-License-Identifier: GPL-2.0-or-later
"""Rows as a table in HTML: in a notebook, on the page of a flight, in the index of a folder."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence


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
