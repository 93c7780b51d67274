# SPDX-License-Identifier: GPL-2.0-or-later
"""What went wrong in a flight: events as rows, rows as incidents, and what the top of the page says of them."""

from __future__ import annotations

import html
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

from .flight import Flight
from .records import INCIDENT, TOGETHER
from .tables import Column

Record = dict[str, Any]
# What an event other than a fault means; those of the first kind are told one by one, the others counted for a source,
# under their own name where none stands here.
SINGLE = {
    "reboot": "reboot",
    "silence": "silence",
    "absent": "never came",
    "shared": "two controllers share this ID: its other events are left out",
    "jump": "the controller's clock jumped ahead",
}
COUNTED = {
    "clock": "the capture's clock went back",
    "missing": "messages missing by Seq No",
    "dropped": "packets dropped while capturing",
    "stale": "the controller's time stood still",
    "crc": "bad CRC",
    "incomplete": "lost frames",
    "unfinished": "cut off by the end of the capture",
    "skipped": "bytes of no frame",
    "invalid": "undefined value",
}
ELSEWHERE = ("fault", "unknown")  # these have rows of their own
SERIOUS = ("fault", "reboot", "silence", "absent", "shared")  # these come first
MORE = 4  # incidents that are told at the top besides the first
HEADS = ("what", "source", "begin", "seconds", "UTC", "duration", "details")


def flag_of(flight: Flight, event: Record) -> Column | None:
    """The column of the flag that an event is about."""
    known = flight.messages.get(event["message"])
    if known is None or event["kind"] != "fault":
        return None
    flags = (column for column in known.columns.values() if column.role == "flag")
    return next((column for column in flags if column.name.endswith(f"_{event['flag']}")), None)


def _row(event: Record, what: str, **more: object) -> Record:
    about = {"kind": event["kind"], "what": what, "source": event["who"], "bus": event["bus"], "id": event["id"]}
    about |= {
        "controller": event["controller"],
        "message": event["title"],
        "begin": event["at"],
        "end": event["at"],
        "length": None,
        "help": event["help"],
    }
    return about | {"count": 1, "bytes": None, "at": [event["at"]]} | more


def fault_rows(flight: Flight, events: list[Record], end: float) -> list[Record]:
    """Each fault from raised to cleared, or to the end of the capture where `end` is None."""
    rows: list[Record] = []
    open_rows: dict[tuple[str, str, str], Record] = {}
    for event in events:
        if event["kind"] != "fault":
            continue
        key = event["who"], event["message"], event["flag"]
        if event["event"] == "raised" or (event["event"] == "cleared" and key not in open_rows):
            flag = flag_of(flight, event)
            # One that is cleared alone was raised before what a filter let through.
            begin = event["at"] - (event["active"] or 0.0)
            row = _row(event, flag.title if flag else event["flag"], begin=begin, end=None, length=end - begin)
            open_rows[key] = row
            rows.append(row)
        if event["event"] != "raised" and key in open_rows:
            row = open_rows.pop(key)
            row["end"] = event["at"] if event["event"] == "cleared" else None
            row["length"] = event["active"]
    return rows


def other_rows(flight: Flight, events: list[Record]) -> list[Record]:
    """Reboots and silences one by one; what may come often as one row for each source and message."""
    rows: dict[tuple[str, ...], Record] = {}
    for number, event in enumerate(events):
        kind, length = event["kind"], event["length"] or 0.0
        if kind in ELSEWHERE:
            continue
        what = SINGLE.get(kind) or COUNTED.get(kind) or str(kind)
        if kind == "invalid":
            what = f"{what}: {_value(flight, event)}"
        key = (kind, event["who"], event["title"], what) if kind not in SINGLE else (str(number),)
        row = rows.setdefault(key, _row(event, what, count=0, at=[]))
        row["count"] += event["count"] or 1
        row["at"].append(event["at"])
        row["end"] = event["at"]
        if kind == "silence":
            row["end"], row["length"] = event["at"] + length, length
        if kind == "skipped":
            row["bytes"] = (row["bytes"] or 0) + int(length)
    return list(rows.values())


def _value(flight: Flight, event: Record) -> str:
    """What a field had that the catalogue does not define: "Key 0x11"."""
    message = flight.messages.get(event["message"])
    column = message.columns.get(event["field"]) if message else None
    value = event["value"] or ""
    return f"{column.title if column else event['field']} {int(value):#x}" if value.isdigit() else value


def joined(rows: list[Record]) -> list[Record]:
    """Join faults, silence and reboot of one controller that belong together to one row with its details."""
    found: list[Record] = []
    latest: dict[object, Record] = {}
    for row in sorted(rows, key=lambda row: float(row["begin"])):
        one = row["controller"]
        last = latest.get(one) if row["kind"] in INCIDENT and one else None
        if last and (last["until"] is None or row["begin"] <= last["until"] + TOGETHER):
            last["rows"].append(row)
            last["until"] = None if last["until"] is None or row["end"] is None else max(last["until"], row["end"])
            continue
        incident = {"begin": row["begin"], "until": row["end"], "source": row["source"], "rows": [row]}
        found.append(incident)
        if row["kind"] in INCIDENT and one:
            latest[one] = incident
    for incident in found:
        whats = dict.fromkeys(row["what"] for row in incident["rows"])
        incident["what"] = ", ".join(whats)
        incident["is_fault"] = any(row["kind"] == "fault" for row in incident["rows"])
        incident["is_serious"] = any(row["kind"] in SERIOUS for row in incident["rows"])
        fault = next((row for row in incident["rows"] if row["kind"] == "fault"), incident["rows"][0])
        incident["source"] = fault["source"]
    return found


# ---- as HTML


def head(data: Record) -> dict[str, str]:
    """Return of which flight the page is: texts by their mark in report.html."""
    day = f"{datetime.fromtimestamp(data['epoch'], UTC):%Y-%m-%d}"
    about = (
        f"<span><span class=pale>{html.escape(name)}</span> {html.escape(text)}</span>" for name, text in data["about"]
    )
    doubts = [text for text in data["left_out"] if text != data["undecoded"]]
    level = f"Never changed: {'; '.join(data['level'])}." if data["level"] else ""
    return {
        "/*NAME*/": html.escape(data["name"]),
        "/*WHEN*/": f"{day} {_utc(data, 0)} UTC, {_duration(data['length'])}",
        "/*ABOUT*/": "".join(about),
        "/*PARTIAL*/": html.escape(" · ".join(doubts)),
        "/*BEGIN*/": _utc(data, 0),
        "/*LEVEL*/": html.escape(level),
    }


def undecoded(data: Record) -> str:
    """Return what was not decoded."""
    return f"{html.escape(data['undecoded'])}." if data["undecoded"] else ""


def verdict(data: Record) -> str:
    """Return what went wrong first: a fault, else what is serious, else anything."""
    incidents = data["incidents"]  # the serious ones come first
    first = next((row for row in incidents if row["is_fault"]), incidents[0] if incidents else None)
    where = " in what was decoded" if data["left_out"] else ""
    if first is None:
        return "" if data["differs"] else f"Nothing{where}."
    lead = "" if first["is_fault"] else f"No fault{where}. "
    times = sum(row["count"] for row in first["rows"])
    often = f", {times} times" if times > 1 and not first["is_serious"] else ""
    lasts = "" if often else _length(first, data["length"])
    many = f"{len(incidents)} incident{'s' * (len(incidents) != 1)} in all."
    return (
        f"{lead}<b class=bad>{html.escape(first['what'])}</b> on <b>{html.escape(first['label'])}</b> at "
        f"{_when(data, first['begin'])}{lasts}{often}. <span class=pale>{many}</span>"
    )


def besides(data: Record) -> str:
    """Return the other serious incidents as a list, the longest first, and who is different from the others."""
    serious = [row for row in data["incidents"] if row["is_serious"]]
    first = next((row for row in serious if row["is_fault"]), serious[0] if serious else None)
    others = sorted((row for row in serious if row is not first), key=lambda row: _seconds(row, data["length"]))
    items = []
    for row in others[: -MORE - 1 : -1]:
        lasts = _length(row, data["length"])
        items.append(
            (f"{row['label']}: {row['what']} at {_clock(row['begin'])}{lasts}", row["begin"], row["until"], "bad")
        )
    items += [(f"{row['label']}: {row['text']}", row["at"], row.get("end"), "") for row in data["differs"]]
    return "".join(f"<li class='{kind}' {_zoom(begin, end)}>{_button(text)}</li>" for text, begin, end, kind in items)


def table(data: Record) -> str:
    """Return a row for each incident; its button zooms to it, another one unfolds what it is made of."""
    heads = "".join(f"<th>{head}</th>" for head in HEADS)
    return f"<thead><tr>{heads}</tr></thead><tbody>{''.join(_lines(data))}</tbody>"


def _lines(data: Record) -> Iterator[str]:
    for incident in data["incidents"]:
        rows = incident["rows"]
        details = _details(rows[0])
        if len(rows) > 1:
            details = f"<button type=button aria-expanded=false>{len(rows)} events</button>"
        kind = "fault" if incident["is_fault"] else ""
        yield _line(data, kind, incident, incident["until"], details)
        for row in rows if len(rows) > 1 else ():
            yield _line(data, "part", row, row["end"], _details(row))


def _line(data: Record, kind: str, row: Record, end: float | None, details: str) -> str:
    begin = row["begin"]
    length = _duration(end - begin) if end is not None and end > begin else ""
    if end is None:
        length = f"still active, {_duration(data['length'] - begin)}"
    numbers = (_clock(begin), _plain_seconds(begin), _utc(data, begin), length)
    cells = "".join(f"<td class=number>{text}</td>" for text in numbers)
    return (
        f"<tr class='{kind}' {_zoom(begin, end)}{' hidden' * (kind == 'part')}><td>{_button(row['what'])}</td>"
        f"<td>{html.escape(row['label'])}</td>{cells}<td class=long>{details}</td></tr>"
    )


def _details(row: Record) -> str:
    count = f"{row['count']} times" if row["count"] > 1 else ""
    size = f"{row['bytes']} bytes" if row["bytes"] else ""
    return html.escape(", ".join(text for text in (count, size, row["message"], row["help"]) if text))


def _button(text: str) -> str:
    return f"<button type=button class=row>{html.escape(text)}</button>"


def _zoom(begin: float, end: float | None) -> str:
    return f"data-begin={begin!r} data-end={'' if end is None else repr(end)}"


def _seconds(row: Record, whole: float) -> float:
    return float(whole if row["until"] is None else row["until"]) - float(row["begin"])


def _length(row: Record, whole: float) -> str:
    if row["until"] is None or row["until"] >= whole - 1:
        return ", until the end"
    return f", for {_duration(row['until'] - row['begin'])}" if row["until"] > row["begin"] else ""


# ---- times as people read them


def _duration(seconds: float) -> str:
    if seconds < 1:
        return f"{seconds * 1000:.6g} ms"
    if seconds < 60:
        return _plain_seconds(seconds)
    return f"{int(seconds // 60)} min {_plain_seconds(seconds % 60)}"


def _plain_seconds(seconds: float) -> str:
    return f"{seconds:.3f}".rstrip("0").rstrip(".") + " s"


def _clock(seconds: float) -> str:
    """612.439 is 10:12.439."""
    minutes, rest = divmod(round(abs(seconds) * 1000), 60_000)
    return f"{'-' * (seconds < 0)}{minutes}:{rest // 1000:02}.{rest % 1000:03}"


def _utc(data: Record, seconds: float) -> str:
    whole, part = divmod(round((data["epoch"] + seconds) * 1000), 1000)
    return f"{datetime.fromtimestamp(whole, UTC):%H:%M:%S}.{part:03}"


def _when(data: Record, seconds: float) -> str:
    return f"{_clock(seconds)} ({_plain_seconds(seconds)}), {_utc(data, seconds)} UTC"
