# SPDX-License-Identifier: GPL-2.0-or-later
"""The card of a fault, as -z yapp,fault tells it: what changed before it, and what else happened. As HTML, a panel."""

from __future__ import annotations

import html
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from .matrix import DIGITS
from .scratch import scratch
from .tables import Column, Message
from .tshark import Tshark

Record = dict[str, Any]
MOST = 8  # cards of a page


def read(capture: Path, tshark: Tshark, numbers: Iterable[int]) -> tuple[list[Record], list[str]]:
    """Return the cards of these faults, from 1, and what the plugin says of them."""
    with scratch() as folder:
        rows, said = tshark.ask(capture, str(folder), [f"fault,{number},json" for number in numbers])
    return [row for row in rows if row.get("incident") is not None], said


def panel(card: Record, messages: Mapping[str, Message]) -> str:
    """Return a card as HTML: flags with their help, what left its range, the others, events, messages."""
    parts = [f"<p><b>{html.escape(each['flag'])}</b> {html.escape(each['help'] or '')}</p>" for each in card["flags"]]
    changes = [
        (f"{each['since']:.3f} s", _column(messages, each).title or each["field"], _change(each, messages))
        for each in card["changes"]
    ]
    nothing = "<p>no value left its range of the ten seconds before</p>"
    parts.append(_table("left its range of the ten seconds before", changes) or nothing)
    sections = {"command": "latest Command", "others": "other controllers", "messages": "messages around it"}
    for key, title in sections.items():
        names = list(dict.fromkeys(name for each in card[key] for name in each["values"]))
        names = [name for name in names if _is_shown(messages, card[key][0]["message"], name)]
        heads = ["", "frame", "", *(_title(messages, card[key][0]["message"], name) for name in names)]
        rows = [
            (f"{each['since']:.3f} s", f"{each['frame']:,}", each["source"] or f"{each['id']:#x}",
             *(_number(each["values"].get(name), _column(messages, each | {"field": name}).unit) for name in names))
            for each in card[key]
        ]  # fmt: skip
        parts.append(_table(title, rows, heads))
    events = [
        ("" if each["time"] is None else f"{each['time'] - card['time']:.3f} s", f"{each['frame'] or 0:,}",
         each["source"] or each["bus"] or "", _event(each))
        for each in card["events"]
    ]  # fmt: skip
    parts.append(_table("events within a second", events) or "<p>no event within a second</p>")
    return "".join(parts)


def _column(messages: Mapping[str, Message], row: Record) -> Column:
    message = messages.get(row["message"])
    return (message.columns if message else {}).get(row["field"]) or Column(row["field"], None, "value", row["field"])


def _title(messages: Mapping[str, Message], message: str, name: str) -> str:
    column = _column(messages, {"message": message, "field": name})
    return f"{column.title}, {column.unit}" if column.unit else column.title


def _is_shown(messages: Mapping[str, Message], message: str, name: str) -> bool:
    return _column(messages, {"message": message, "field": name}).role in ("value", "enum")


def _change(row: Record, messages: Mapping[str, Message]) -> str:
    if row["flag"]:
        words = {0: "off", 1: "on", None: "no value"}
        return f"{row['flag']} {words[row['from']]} → {words[row['to']]}"
    times = f" ({row['times']:.1f} times)" if row["times"] and not 0.67 < row["times"] < 1.5 else ""
    values = _column(messages, row).values
    ends = [
        "no value" if each is None else values.get(int(each)) or _number(each, row["unit"])
        for each in (row["from"], row["to"], row["at_fault"])
    ]
    return f" {ends[0]} → {ends[1]} {row['unit'] or ''}{times}, {ends[2]} at the fault"


def _event(row: Record) -> str:
    length = f"{row['length']:.3f} s" if row["kind"] in ("silence", "disabled", "jump") and row.get("length") else ""
    words = (row["kind"], row.get("message"), row.get("flag"), row.get("event"), row.get("what"), length)
    return " ".join(word for word in words if word)


def _number(value: Any, unit: str = "") -> str:
    if isinstance(value, int | float | Decimal) and not isinstance(value, bool):
        return f"{float(value):.{DIGITS[unit]}f}" if unit in DIGITS else f"{float(value):.5g}"
    return "" if value is None else str(value)


def _table(title: str, rows: Sequence[Sequence[str]], heads: Sequence[str] = ()) -> str:
    if not rows:
        return ""
    return f"<section><p class=pale>{title}</p><table>{''.join(_rows(heads, rows))}</table></section>"


def _rows(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"<tr>{''.join(f'<th>{html.escape(head)}</th>' for head in heads)}</tr>" if heads else ""
    for row in rows:
        kinds = ("number" if cell[:1].isdigit() or cell[:1] == "-" else "" for cell in row)
        both = zip(kinds, row, strict=True)
        yield f"<tr>{''.join(f'<td class={kind!r}>{html.escape(cell)}</td>' for kind, cell in both)}</tr>"
