# SPDX-License-Identifier: GPL-2.0-or-later
"""The top of the page: a verdict, one line a controller, one sentence a cause, and the table of incidents."""

import html
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime

from .errors import count_of
from .series import DEGREES
from .tshark import Record

HEADS = ("what", "source", "begin", "UTC", "duration", "frames", "details")
LOSSES = ("incomplete", "crc", "missing", "stale")
FEW = 3  # incidents of a kind that are told one by one
ABOUT = "<span><span class=pale>{}</span> {}</span>"
SHARE = 0.8  # of a flight, and more, is throughout


def duration(seconds: float, digits: int = 3) -> str:
    """Return `0.450 s`, `40.504 s`, `2 min 24.000 s`."""
    minutes, rest = divmod(round(seconds, digits), 60)
    return f"{minutes:.0f} min " * bool(minutes) + f"{rest:.{digits}f} s"


def about(seconds: float) -> str:
    """Return a duration for a headline: `0.45 s`, `40 s`, `2 min 24 s`."""
    return f"{seconds:.2g} s" if seconds < 9.95 else duration(seconds, 0)


def clock(seconds: float) -> str:
    """Return 612.439 as `10:12.439`."""
    minutes, rest = divmod(round(abs(seconds) * 1000), 60_000)
    return f"{'-' * (seconds < 0)}{minutes}:{rest // 1000:02}.{rest % 1000:03}"


def utc(epoch: float, seconds: float) -> str:
    """Return the time of day in UTC, `14:33:32.037`."""
    return f"{datetime.fromtimestamp(round(epoch + seconds, 3), UTC):%H:%M:%S.%f}"[:-3]


def causes(data: Record) -> dict[str, list[Record]]:
    """Return what is said of each controller, the worst first: {label: [{text, begin, end, bad, weight}]}."""
    said: list[Record] = []
    for rows in _groups([row for row in data["incidents"] if row["is_serious"]], "label", "what"):
        weight = 100.0 if rows[0]["is_fault"] else 90.0 if "reboot" in rows[0]["kinds"] else 80.0
        known = {"who": rows[0]["label"], "weight": weight, "bad": True}
        if len(rows) > FEW:
            text = f"{rows[0]['what']} {len(rows)} times, {clock(rows[0]['begin'])} to {clock(rows[-1]['begin'])}"
            text += f", at most {duration(_longest(rows, data))}"
            said.append(known | {"text": text, "begin": rows[0]["begin"], "end": rows[-1]["until"]})
        else:
            said += [known | {"text": _incident(row, data), "begin": row["begin"], "end": row["until"]} for row in rows]
    for rows in _groups(data["differs"], "label"):
        for weight, text, row in _differences(rows, data["length"]):
            known = {"who": row["label"], "weight": weight, "bad": False}
            said.append(known | {"text": text, "begin": row["at"], "end": row["end"]})
    said.sort(key=lambda one: (-one["weight"], one["begin"]))
    return {rows[0]["who"]: rows for rows in _groups(said, "who")}


def _groups(rows: Iterable[Record], *keys: str) -> list[list[Record]]:
    """Return rows that have the same values of these keys together, in the order of the first ones."""
    groups: dict[tuple[object, ...], list[Record]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(groups.values())


def _longest(rows: Sequence[Record], data: Record) -> float:
    """Return how long the longest incident is."""
    return float(max((data["length"] if row["until"] is None else row["until"]) - row["begin"] for row in rows))


def _incident(row: Record, data: Record) -> str:
    rows, kinds, begin, until = row["rows"], row["kinds"], row["begin"], row["until"]
    lasts = "until the end" if until is None or until >= data["length"] - 1 else duration(until - begin)
    if row["is_fault"]:
        faults = [one for one in rows if one["kind"] == "fault"]
        names = list(dict.fromkeys(one["what"] for one in faults))
        names = [name for name in names if name != "Faulted"] or names
        at, ends = min(one["begin"] for one in faults), [one["end"] for one in faults]
        lasts = "until the end" if None in ends else duration(max(ends) - at)
        times = sum(one["what"] == names[0] for one in faults)
        text = f"{', '.join(names)} at {clock(at)}, {f'{times} times in ' * (times > 1)}{lasts}"
        for one in data["differs"]:
            if one["kind"] == "surge" and one["label"] == row["label"] and at - 2 <= one["at"] <= (until or at):
                text += f"; {one['title']} {one['value']:.1f} {one['unit']}, {one['times']:.1f} times the others'"
                text += f", from {at - one['at']:.3f} s before" * (one["at"] < at)
        more = [word for kind, word in (("reboot", "a reboot"), ("silence", "silence")) if kind in kinds]
        return f"{text}; then {' and '.join(more)}" if more else text
    if "reboot" in kinds:
        times = reboots_of(row)
        text = f"rebooted {f'{times} times, the last ' * (times > 1)}at {clock(until or begin)}"
        return text + f", silent {lasts}" * ("silence" in kinds)
    if kinds == ["silence"] and not rows[0]["is_command"] and "bus" not in row:
        end = data["length"] if until is None else until
        came = (one for other in data["incidents"] for one in other["rows"] if one["kind"] in ("crc", "incomplete"))
        damaged = sum(begin <= at <= end for one in came if one["source"] == row["source"] for at in one["at"])
        text = f"silent {lasts}, from {clock(begin)}"
        text += f", in which {count_of(damaged, 'damaged message')} came" if damaged else ""
        return f"{text}{'; Commands lost, too' * any(one['is_command'] for one in rows)}"
    text = f"{row['what']} {f'{lasts} ' * (until != begin)}at {clock(begin)}"
    if lasts == "until the end":
        text = f"{row['what']} at {clock(begin)}, {lasts}"
    return f"{text}; {row['stopped']}" if row.get("stopped") else text


def reboots_of(row: Record) -> int:
    """Return how often a controller rebooted in an incident, by its fastest message."""
    reboots = [one["every"] for one in row["rows"] if one["kind"] == "reboot"]
    return reboots.count(min(reboots))


def _differences(rows: list[Record], whole: float) -> Iterator[tuple[float, str, Record]]:
    """Yield weight, sentence and row of each cause: what follows from another one stands behind it."""
    hot = sorted((row for row in rows if row["kind"] == "temperature"), key=lambda row: -abs(row["away"]))
    levels = [row for row in rows if row["kind"] == "level"]
    for row in sorted(levels, key=lambda row: (row["unit"] != "A", not row["is_supply"]))[:1]:
        more = row["value"] / row["beside"] - 1 if row["beside"] else 0.0
        what = re.sub("^(DC|Torque IQ) ", "", row["title"]).lower() if row["is_supply"] else row["title"]
        word = "more" if abs(row["value"]) > abs(row["beside"]) else "less"
        when = "throughout" if row["share"] > SHARE else f"in {row['share']:.0%} of the flight"
        if row["end"] is not None and row["share"] <= SHARE:
            when = f"from {clock(row['at'])[:-4]} to {clock(row['end'])[:-4]}"
        text = f"{abs(more):.0%} {word} {what} {when} ({row['value']:.1f} beside {row['beside']:.1f} {row['unit']})"
        warm = [one for one in hot if one["away"] > 0] if word == "more" else []
        if warm:
            text += f", hence {warm[0]['away']:.0f} °C hotter"
            hot = []
        yield 40.0, text, row
    limits = {row["field"]: row for row in rows if row["kind"] in ("limit", "left")}
    if hot:
        row, *others = hot
        end = "at the end" if row["end"] > whole - 10 else f"at {clock(row['end'])[:-4]}"
        word = "above" if row["away"] > 0 else "below"
        text = f"{row['title']} {row['value']:.0f} °C {end}, {abs(row['away']):.0f} {word} the others"
        text += f", {row['slope']:+.1f} °C/min" * (abs(row["slope"]) >= 0.5)
        if limit := limits.pop(row["field"], None):
            text += f"; {_limit(limit, is_short=True)}"
        for one in others:
            text += f"; also {one['title']} {abs(one['away']):.0f} °C {'hotter' if one['away'] > 0 else 'cooler'}"
            if limit := limits.pop(one["field"], None):
                text += f" ({_limit(limit, is_short=True)})"
        yield 60.0 if row["away"] > 0 else 30.0, text, row
    # Who warms as the others do is not called hot before it is.
    for row in (row for row in limits.values() if row["kind"] == "limit"):
        yield 50.0, f"{row['title']} {_limit(row)}", row
    for row in rows:
        if row["kind"] == "sag":
            span = f"{clock(row['at'])[:-4]} to {clock(row['end'])[:-4]}"
            yield 55.0, f"{row['usual']:.1f} to {row['value']:.1f} V, {span}, all controllers{row['more']}", row
        elif row["kind"] == "surge" and not row["has_fault"]:
            text = f"{row['title']} {row['value']:.1f} {row['unit']}, {row['times']:.1f} times the others'"
            yield 45.0, f"{text} for {row['end'] - row['at']:.3f} s at {clock(row['at'])}", row


def _limit(row: Record, is_short: bool = False) -> str:
    limit = f"{row['limit']:g} {row['unit']}"
    if row["kind"] == "left":
        return f"{limit} {about(row['seconds'])} later"
    value = f"{row['value']:.1f} {row['unit']}, " * (not is_short)
    return f"{value}{row['word']} {limit} for {duration(row['seconds'])} from {clock(row['at'])}"


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
            sag["more"] += f"; {rows[0]['word']} {rows[0]['limit']:g} {rows[0]['unit']}"
        else:
            row = min(rows, key=lambda row: row["value"] * (1 if row["word"] == "below" else -1))
            label = "Battery" if row["is_supply"] else count_of(len(who), "controller")
            kept.append(row | {"label": label, "number": None, "at": begin, "end": end})
    return kept


def headline(data: Record) -> tuple[str, str]:
    """Return the verdict, "GOOD", "NOT GOOD" or "UNKNOWN", and what it is made of."""
    faults = [row for row in data["incidents"] if row["is_fault"]]
    rest = [row for row in data["incidents"] if row["is_serious"] and not row["is_fault"]]
    reboots = [row for row in rest if "reboot" in row["kinds"]]
    counts = {"fault": len(faults), "reboot": sum(map(reboots_of, reboots))}
    said = [count_of(count, noun) for noun, count in counts.items() if count]
    for kind, is_command, one, many in (
        ("silence", False, "1 silence of {}", "{n} silences, the longest {}"),
        ("silence", True, "Commands lost {}", "Commands lost {n} times, at most {}"),
        ("disabled", True, "disabled {}", "disabled {n} times, at most {}"),
    ):
        rows = [row for row in rest if row["kinds"] == [kind] and row["rows"][0]["is_command"] == is_command]
        if rows:
            said.append((one if len(rows) == 1 else many).format(about(_longest(rows, data)), n=len(rows)))
    said += dict.fromkeys(row["what"] for row in rest if not {"silence", "disabled", "reboot"} & set(row["kinds"]))
    differs = data["differs"]
    loaded = {row["label"] for row in differs if row["kind"] == "level"}
    hot = {row["label"] for row in differs if (row["kind"] == "temperature" and row["away"] > 0)
           or (row["kind"] == "limit" and row["unit"] in DEGREES)}  # fmt: skip
    sags = [row for row in differs if row["kind"] == "sag"]
    odd = {row["label"] for row in differs if row["kind"] not in ("left", "sag")}
    odd -= (hot - loaded) | {row["label"] for row in faults}
    said += [f"{count_of(len(hot - loaded), 'controller')} too hot"] if hot - loaded else []
    said += [f"battery down to {min(row['value'] for row in sags):.1f} V"] if sags else []
    said += [f"{count_of(len(odd), 'other controller' if hot - loaded else 'controller')} to look at"] if odd else []
    losses: Counter[tuple[str, bool]] = Counter()
    for one in (one for row in data["incidents"] for one in row["rows"] if one["kind"] in LOSSES):
        losses[one["label"], one["kind"] == "missing"] += one["count"]
    who = sorted({label for label, _ in losses})
    # One that came damaged is missing, too.
    count = sum(max(losses[label, True], losses[label, False]) for label in who)
    whose = f" of {who[0]}" if len(who) == 1 else ""
    lost = [f"{count_of(count, 'message')}{whose} damaged or lost"] if who else []
    if said:
        return "NOT GOOD", ", ".join(said + lost)
    if data["left_out"]:
        return "UNKNOWN", "no fault, reboot or silence in what was decoded"
    return "GOOD", ", ".join(["no fault, reboot, silence or odd controller", *lost])


# ---- as HTML


def head(data: Record) -> dict[str, str]:
    """Return the top of the page: texts by their mark in report.html."""
    word, text = headline(data)
    day = f"{datetime.fromtimestamp(data['epoch'], UTC):%Y-%m-%d}"
    decoded = "not all decoded" if data["left_out"] else "all decoded"
    return {
        "/*NAME*/": html.escape(data["name"]),
        "/*WHEN*/": f"{day} {utc(data['epoch'], 0)} UTC, {duration(data['length'])}",
        "/*ABOUT*/": "".join(ABOUT.format(html.escape(name), html.escape(told)) for name, told in data["about"]),
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
    spans = ", ".join(f"{clock(begin)[:-4]} to {clock(end)[:-4]}" for begin, end in data["flight"])
    flight = f"In flight (by speed) {spans}; means are of the flight only. " if spans else ""
    found = {*causes(data), *(row["label"] for row in data["incidents"])}
    innocent = [label for label in data["controllers"] if label not in found]
    innocent += [] if any("bus" in row["kinds"] for row in data["incidents"]) else ["the buses"]
    flight = f"No findings about {', '.join(innocent)}. {flight}" if innocent else flight
    if limits := ", ".join(data["limits"]):
        return f"{flight}Limits: the default set of this page, not yours: {limits}; --rules FILE draws yours."
    return f"{flight}{data['margin']}"


def table(data: Record) -> str:
    """Return a row for each incident; its button zooms to it, another one unfolds what it is made of."""
    lines = "".join(line for incident in data["incidents"] for line in _lines(incident, data))
    heads = "".join(f"<th>{head}</th>" for head in HEADS)
    return f"<thead><tr>{heads}</tr></thead><tbody>{lines}</tbody>" if lines else ""


def _lines(incident: Record, data: Record) -> Iterator[str]:
    rows, card, details = incident["rows"], incident.pop("card", ""), _details(incident["rows"][0])
    if card or len(rows) > 1:
        text = "card of the fault" if card else f"{len(rows)} events"
        details = f"<button type=button aria-expanded=false>{text}</button>"
    yield _line(data, "fault" if incident["is_fault"] else "", incident, incident["until"], details)
    if card:
        yield f"<tr class=part hidden><td colspan={len(HEADS)} class=card>{card}</td></tr>"
    for row in rows if len(rows) > 1 else ():
        yield _line(data, "part", row, row["end"], _details(row))


def _line(data: Record, kind: str, row: Record, end: float | None, details: str) -> str:
    begin, filter_ = row["begin"], html.escape(row["filter"], quote=True)
    is_one = all(one["count"] == 1 for one in row.get("rows", [row]))
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
    return f"data-begin={begin!r} data-end='{'' if end is None else repr(end)}'"


def series_of(names: Sequence[str]) -> str:
    """Return `F1 to F4` for names with numbers that follow each other, else all of them."""
    stem, first = re.fullmatch(r"(.*?)(\d*)", names[0]).groups()  # type: ignore[union-attr]
    follow = [f"{stem}{int(first or 0) + at}" for at in range(len(names))]
    return f"{names[0]} to {names[-1]}" if len(names) > 2 and names == follow else ", ".join(names)
