# SPDX-License-Identifier: GPL-2.0-or-later
"""The top of the page: a verdict, one line a controller, one sentence a cause, and the table of incidents."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

from .errors import count_of
from .series import DEGREES
from .words import about, clock, duration, minute, utc

Record = dict[str, Any]
HEADS = ("what", "source", "begin", "UTC", "duration", "frames", "details")
LOSSES = ("incomplete", "crc", "missing", "stale")
FEW = 3  # incidents of a kind that are told one by one
SHARE = 0.8  # of a flight, and more, is throughout


def causes(data: Record) -> dict[str, list[Record]]:
    """Return what is said of each controller, the worst first: {label: [{text, begin, end, bad, weight}]}."""
    said: list[Record] = []

    def add(row: Record, weight: float, text: str, begin: float, end: float | None, is_bad: bool) -> None:
        about = {"who": row["label"], "weight": weight, "text": text}
        said.append(about | {"begin": begin, "end": end, "bad": is_bad})

    for rows in _groups([row for row in data["incidents"] if row["is_serious"]], "label", "what"):
        weight = 100.0 if rows[0]["is_fault"] else 90.0 if "reboot" in rows[0]["kinds"] else 80.0
        if len(rows) > FEW:
            add(rows[0], weight, _often(rows, data["length"]), rows[0]["begin"], rows[-1]["until"], True)
            continue
        for row in rows:
            add(row, weight, _incident(row, data), row["begin"], row["until"], True)
    for rows in _groups(data["differs"], "label"):
        for weight, text, row in _differences(rows, data["length"]):
            add(row, weight, text, row["at"], row["end"], False)
    said.sort(key=lambda one: (-one["weight"], one["begin"]))
    return {rows[0]["who"]: rows for rows in _groups(said, "who")}


def _groups(rows: Iterable[Record], *keys: str) -> list[list[Record]]:
    """Return rows that have the same values of these keys together, in the order of the first ones."""
    groups: dict[tuple[object, ...], list[Record]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(groups.values())


def _often(rows: list[Record], whole: float) -> str:
    """Say what came many times in one sentence."""
    longest = max((whole if row["until"] is None else row["until"]) - row["begin"] for row in rows)
    span = f"{clock(rows[0]['begin'])} to {clock(rows[-1]['begin'])}"
    return f"{rows[0]['what']} {len(rows)} times, {span}, at most {duration(longest)}"


def _incident(row: Record, data: Record) -> str:
    rows, kinds, begin = row["rows"], row["kinds"], row["begin"]
    length = None if row["until"] is None else row["until"] - begin
    lasts = "until the end" if length is None or row["until"] >= data["length"] - 1 else duration(length)
    if row["is_fault"]:
        faults = [one for one in rows if one["kind"] == "fault"]
        names = list(dict.fromkeys(one["what"] for one in faults))
        names = [name for name in names if name != "Faulted"] or names
        ends = [one["end"] for one in faults]
        at = min(one["begin"] for one in faults)
        lasts = "until the end" if None in ends else duration(max(ends) - at)
        times = sum(one["what"] == names[0] for one in faults)
        often = f"{times} times in " if times > 1 else ""
        text = f"{', '.join(names)} at {clock(at)}, {often}{lasts}"
        surges = (one for one in data["differs"] if one["kind"] == "surge" and one["label"] == row["label"])
        near = next((one for one in surges if at - 2 <= one["at"] <= (row["until"] or at)), None)
        if near:
            text += f"; {near['title']} {near['value']:.1f} {near['unit']}, {near['times']:.1f} times the others'"
            text += f", from {at - near['at']:.3f} s before" if near["at"] < at else ""
        more = [word for kind, word in (("reboot", "a reboot"), ("silence", "silence")) if kind in kinds]
        return f"{text}; then {' and '.join(more)}" if more else text
    if "reboot" in kinds:
        return f"rebooted at {clock(row['until'] or begin)}" + (f", silent {lasts}" if "silence" in kinds else "")
    if kinds == ["silence"] and not rows[0]["is_command"]:
        return f"silent {lasts}, from {clock(begin)}"
    text = f"{row['what']} {lasts} at {clock(begin)}" if length else f"{row['what']} at {clock(begin)}"
    return f"{text}; {row['stopped']}" if row.get("stopped") else text


def _differences(rows: list[Record], whole: float) -> Iterator[tuple[float, str, Record]]:
    """Yield weight, sentence and row of each cause: what follows from another one stands behind it."""
    hot = sorted((row for row in rows if row["kind"] == "temperature"), key=lambda row: -abs(row["away"]))
    levels = [row for row in rows if row["kind"] == "level"]
    for row in sorted(levels, key=lambda row: (row["unit"] != "A", not row["is_supply"]))[:1]:
        more = row["value"] / row["beside"] - 1 if row["beside"] else 0.0
        what = re.sub("^(DC|Torque IQ) ", "", row["title"]).lower() if row["is_supply"] else row["title"]
        word = "more" if abs(row["value"]) > abs(row["beside"]) else "less"
        when = "throughout" if row["share"] > SHARE else f"in {row['share']:.0%} of the flight"
        text = f"{abs(more):.0%} {word} {what} {when} ({row['value']:.1f} beside {row['beside']:.1f} {row['unit']})"
        warm = next((one for one in hot if one["away"] > 0), None) if word == "more" else None
        if warm:
            text += f", hence {warm['away']:.0f} °C hotter"
            hot = []
        yield 40.0, text, row
    # Who warms as the others do is not called hot before it is.
    hot_fields = {row["field"] for row in hot}
    limits = {row["field"]: row for row in rows if row["kind"] == "limit" or (row["kind"] == "left" and
              row["field"] in hot_fields)}  # fmt: skip
    if hot:
        row = hot[0]
        end = "at the end" if row["end"] > whole - 10 else f"at {minute(row['end'])}"
        word = "above" if row["away"] > 0 else "below"
        text = f"{row['title']} {row['value']:.0f} °C {end}, {abs(row['away']):.0f} {word} the others"
        text += f", {row['slope']:+.1f} °C/min" if abs(row["slope"]) >= 0.5 else ""
        limit = limits.pop(row["field"], None)
        text += f"; {_limit(limit, is_short=True)}" if limit else ""
        for one in hot[1:]:
            limit = limits.pop(one["field"], None)
            told = f" ({_limit(limit, is_short=True)})" if limit else ""
            text += f"; also {one['title']} {abs(one['away']):.0f} °C {'hotter' if one['away'] > 0 else 'cooler'}{told}"
        yield 60.0 if row["away"] > 0 else 30.0, text, row
    for row in limits.values():
        yield 50.0, f"{row['title']} {_limit(row)}", row
    for row in rows:
        if row["kind"] == "sag":
            yield 55.0, row["text"], row
        elif row["kind"] == "follows":
            yield 20.0, f"{row['title']} {row['text']}", row
        elif row["kind"] == "surge" and not row["has_fault"]:
            text = f"{row['title']} {row['value']:.1f} {row['unit']}, {row['text']} for {row['end'] - row['at']:.3f} s"
            yield 45.0, f"{text} at {clock(row['at'])}", row


def _limit(row: Record, is_short: bool = False) -> str:
    limit = f"{row['limit']:g} {row['unit']}"
    if row["kind"] == "left":
        return f"{limit} {about(row['seconds'])} later" if is_short else f"reaches {limit} in {about(row['seconds'])}"
    lasts = f"for {duration(row['seconds'])} from {clock(row['at'])}"
    value = "" if is_short else f"{row['value']:.1f} {row['unit']}, "
    return f"{value}{row['word']} {limit} {lasts}"


def merged(differs: list[Record], controllers: int) -> list[Record]:
    """Return them with one row for what all controllers have at one time: the battery, if it is the supply."""
    kept = [row for row in differs if row["kind"] != "limit"]
    sag = next((row for row in kept if row["kind"] == "sag"), None)
    for rows in _groups([row for row in differs if row["kind"] == "limit"], "field", "word"):
        begin, end = min(row["at"] for row in rows), max(row["end"] for row in rows)
        who = {row["label"] for row in rows}
        if len(who) < max(3, 2 / 3 * controllers):
            kept += rows
        elif sag and rows[0]["is_supply"] and sag["at"] - 2 <= begin <= sag["end"] + 2:
            sag["text"] += f"; {rows[0]['word']} {rows[0]['limit']:g} {rows[0]['unit']}"
        else:
            row = min(rows, key=lambda row: row["value"] * (1 if row["word"] == "below" else -1))
            label = "Battery" if row["is_supply"] else f"{count_of(len(who), 'controller')}"
            kept.append(row | {"label": label, "number": None, "at": begin, "end": end})
    return kept


def headline(data: Record) -> tuple[str, str]:
    """Return the verdict, "GOOD", "NOT GOOD" or "UNKNOWN", and what it is made of."""
    incidents, said = data["incidents"], []
    faults = [row for row in incidents if row["is_fault"]]
    said += [count_of(len(faults), "fault")] if faults else []
    rest = [row for row in incidents if row["is_serious"] and not row["is_fault"]]
    reboots = [row for row in rest if "reboot" in row["kinds"]]
    said += [count_of(len(reboots), "reboot")] if reboots else []
    for kind, is_command, one, many in (
        ("silence", False, "1 silence of {}", "{n} silences, the longest {}"),
        ("silence", True, "Commands lost {}", "Commands lost {n} times, at most {}"),
        ("disabled", True, "disabled {}", "disabled {n} times, at most {}"),
    ):
        rows = [row for row in rest if row["kinds"] == [kind] and row["rows"][0]["is_command"] == is_command]
        if rows:
            longest = max((data["length"] if row["until"] is None else row["until"]) - row["begin"] for row in rows)
            said.append((one if len(rows) == 1 else many).format(about(longest), n=len(rows)))
    others = [row for row in rest if not {"silence", "disabled", "reboot"} & set(row["kinds"])]
    said += list(dict.fromkeys(row["what"] for row in others))
    loaded = {row["label"] for row in data["differs"] if row["kind"] == "level"}
    hot = {row["label"] for row in data["differs"] if row["kind"] == "temperature" and row["away"] > 0}
    hot |= {row["label"] for row in data["differs"] if row["kind"] == "limit" and row["unit"] in DEGREES}
    odd = {row["label"] for row in data["differs"] if row["kind"] != "left"} - hot
    said += [f"{count_of(len(hot - loaded), 'controller')} too hot"] if hot - loaded else []
    sags = [row for row in data["differs"] if row["kind"] == "sag"]
    said += [f"battery down to {min(row['value'] for row in sags):.1f} V"] if sags else []
    odd = (odd | (hot & loaded)) - {row["label"] for row in sags} - {row["label"] for row in faults}
    said += [f"{count_of(len(odd), 'other controller' if hot - loaded else 'controller')} to look at"] if odd else []
    losses = sum(one["count"] for row in incidents for one in row["rows"] if one["kind"] in LOSSES)
    lost = [f"{count_of(losses, 'message')} damaged or lost"] if losses else []
    if said:
        return "NOT GOOD", ", ".join(said + lost)
    if data["left_out"]:
        return "UNKNOWN", "no fault, reboot or silence in what was decoded"
    return "GOOD", ", ".join(["no fault, reboot, silence or odd controller", *lost])


# ---- as HTML


def head(data: Record) -> dict[str, str]:
    """Return the top of the page: texts by their mark in report.html."""
    day = f"{datetime.fromtimestamp(data['epoch'], UTC):%Y-%m-%d}"
    told = "".join(f"<span><span class=pale>{html.escape(name)}</span> {html.escape(text)}</span>"
                   for name, text in data["about"])  # fmt: skip
    word, text = headline(data)
    decoded = "not all decoded" if data["left_out"] else "all decoded"
    return {
        "/*NAME*/": html.escape(data["name"]),
        "/*WHEN*/": f"{day} {utc(data['epoch'], 0)} UTC, {duration(data['length'])}",
        "/*ABOUT*/": told,
        "/*DOUBTS*/": html.escape(" · ".join(data["left_out"])),
        "/*VERDICT*/": f"<b class={'good' if word == 'GOOD' else 'bad'}>{word}</b>: {html.escape(text)}; {decoded}.",
        "/*CAUSES*/": "".join(_cause(who, said) for who, said in causes(data).items()),
        "/*PHASES*/": html.escape(_phases(data)),
        "/*INCIDENTS*/": table(data),
        "/*BEGIN*/": utc(data["epoch"], 0),
    }


def _cause(who: str, said: Sequence[Record]) -> str:
    ends = [";"] * (len(said) - 1) + ["."]
    buttons = " ".join(
        f"<button type=button class='row {'bad' if one['bad'] else ''}' {_zoom(one['begin'], one['end'])}>"
        f"{html.escape(one['text'])}{end}</button>" for one, end in zip(said, ends, strict=True))  # fmt: skip
    return f"<li><b>{html.escape(who)}</b>: {buttons}</li>"


def _phases(data: Record) -> str:
    spans = [f"{minute(begin)} to {minute(end)}" for begin, end in data["flight"]]
    flight = f"In flight (by speed) {', '.join(spans)}; means are of the flight only. " if spans else ""
    limits = ", ".join(data["limits"])
    if data["has_default_limits"]:
        return f"{flight}Limits: the default set of this page, not yours: {limits}; --rules FILE draws yours."
    return f"{flight}Limits of {data['rules']}: {limits}." if limits else flight


def table(data: Record) -> str:
    """Return a row for each incident; its button zooms to it, another one unfolds what it is made of."""
    heads = "".join(f"<th>{head}</th>" for head in HEADS)
    lines = "".join(_lines(data))
    return f"<thead><tr>{heads}</tr></thead><tbody>{lines}</tbody>" if lines else ""


def _lines(data: Record) -> Iterator[str]:
    for incident in data["incidents"]:
        rows = incident["rows"]
        details = _details(rows[0])
        card = incident.pop("card", "")
        if card or len(rows) > 1:
            what = "card of the fault" if card else f"{len(rows)} events"
            details = f"<button type=button aria-expanded=false>{what}</button>"
        yield _line(data, "fault" if incident["is_fault"] else "", incident, incident["until"], details)
        yield f"<tr class=part hidden><td colspan={len(HEADS)} class=card>{card}</td></tr>" if card else ""
        for row in rows if len(rows) > 1 else ():
            yield _line(data, "part", row, row["end"], _details(row))


def _line(data: Record, kind: str, row: Record, end: float | None, details: str) -> str:
    begin, filter_ = row["begin"], html.escape(row["filter"], quote=True)
    is_one = row.get("count", 1) == 1 and all(one["count"] == 1 for one in row.get("rows", ()))
    length = duration(end - begin) if end is not None and end > begin and is_one else ""
    if end is None:
        length = f"still active, {duration(data['length'] - begin)}"
    frames = f"<button type=button class=copy data-copy='{filter_}' title='{filter_}'>{row['frames']}</button>"
    cells = "".join(f"<td class=number>{text}</td>" for text in (clock(begin), utc(data["epoch"], begin), length))
    return (
        f"<tr class='{kind}' {_zoom(begin, end)}{' hidden' * (kind == 'part')}>"
        f"<td><button type=button class=row>{html.escape(row['what'])}</button></td>"
        f"<td>{html.escape(row['label'])}</td>{cells}<td class=number>{frames}</td><td class=long>{details}</td></tr>"
    )


def _details(row: Record) -> str:
    count = f"{row['count']} times" if row["count"] > 1 else ""
    return html.escape(", ".join(text for text in (count, row["message"], row["help"]) if text))


def _zoom(begin: float, end: float | None) -> str:
    return f"data-begin={begin!r} data-end={'' if end is None else repr(end)}"


def named(names: Sequence[str]) -> str:
    """Return `F1 to F4` for names with numbers that follow each other, else all of them."""
    found = [re.fullmatch(r"(.*?)(\d+)", name) for name in names]
    if len(names) > 2 and all(found) and len({one[1] for one in found if one}) == 1:
        numbers = [int(one[2]) for one in found if one]
        if numbers == list(range(numbers[0], numbers[0] + len(numbers))):
            return f"{names[0]} to {names[-1]}"
    return ", ".join(names)
