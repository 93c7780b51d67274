# SPDX-License-Identifier: GPL-2.0-or-later
"""What went wrong in a flight: events as rows, rows as incidents."""

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from .series import controllers, source_name
from .tables import OWN, said
from .tshark import Record

Messages = Mapping[str, pa.Schema]
TOGETHER = 2.0  # seconds: events of one controller that are no further apart are one incident
# Kinds of events, as tables.json has them. text: its meaning, the name where there is none; is_incident: part of one;
# is_serious: these come first; is_single: told one by one, others are counted; is_loss; is_other: diff leaves it out.
EVENTS: dict[str, Record] = defaultdict(dict, {row["name"]: row for row in OWN["kinds"]})
CALM = 3.0  # seconds that a controller takes to be as before, after a reboot or a Command that was disabled


def is_command(messages: Messages, message: str | None) -> bool:
    """Return whether a message has no clock of a controller: it is sent to one, or to all on a bus."""
    columns = messages.get(message or "", ())
    return message in messages and "clock" not in {said(column.metadata).get("role") for column in columns}


def events_of(events: pa.Table, messages: Messages, start: int) -> list[Record]:
    """Return events with the keys of rows: who, controller, at (seconds since start, in ns since 1970) and others."""
    own = events.drop_columns(["time"]).append_column("at", events["time"].cast(pa.int64()))
    found: list[Record] = own.to_pylist()
    for event, controller in zip(found, controllers(found), strict=True):
        known = said(messages[event["message"]].metadata) if event["message"] in messages else {}
        event["controller"] = controller
        event["at"] = 0.0 if event["at"] is None else (event["at"] - start) / 1e9
        event["title"] = known.get("title", event["message"] or "")
        event["who"] = source_name(event)
        event["is_command"] = is_command(messages, event["message"])
        event["every"] = float(known.get("every") or 1)
    return found


def faults_in(events: pa.Table) -> int:
    """Return how many incidents of the events have a fault."""
    found = events_of(events, {}, 0)
    end = max((event["at"] for event in found), default=0.0)
    return sum(incident["is_fault"] for incident in joined(fault_rows({}, found, end) + other_rows(found)))


def excused(events: list[Record], names: Mapping[tuple[str | None, int], str]) -> dict[str, list[tuple[float, float]]]:
    """Return when each source, {(bus, ID): name}, is not compared: around its reboots and silences, and a Command's."""
    windows: dict[str, list[tuple[float, float]]] = {}
    for event in events:
        if event["kind"] not in ("reboot", "silence", "disabled"):
            continue
        length = event["length"] or (np.inf if event["kind"] == "disabled" else 0.0)
        span = event["at"] - 0.2, event["at"] + length + CALM
        for (bus, number), name in names.items():
            is_its = event["controller"] is not None and (number ^ (event["id"] or 0)) & 0xF == 0
            if bus == event["bus"] and (event["is_command"] or is_its):
                windows.setdefault(name, []).append(span)
    return windows


def _row(event: Record, what: str, **more: object) -> Record:
    at = event["at"]
    about = {"what": what, "source": event["who"], "message": event["title"], "begin": at, "end": at, "at": [at]}
    return event | about | {"length": None, "count": 1} | more


def fault_rows(messages: Messages, events: list[Record], end: float) -> list[Record]:
    """Each fault from raised to cleared, or to the end of the capture where `end` is None."""
    rows: list[Record] = []
    open_rows: dict[tuple[str, str, str], Record] = {}
    for event in (event for event in events if event["kind"] == "fault"):
        key = event["who"], event["message"], event["flag"]
        if event["event"] == "raised" or (event["event"] == "cleared" and key not in open_rows):
            columns = (one for one in messages.get(event["message"], ()) if one.name.endswith(f"_{event['flag']}"))
            titles = (known["title"] for one in columns if (known := said(one.metadata)).get("role") == "flag")
            what = next(titles, event["flag"])
            # One that is cleared alone was raised before what a filter let through.
            begin = event["at"] - (event["active"] or 0.0)
            open_rows[key] = _row(event, what, begin=begin, end=None, length=end - begin)
            rows.append(open_rows[key])
        if event["event"] != "raised" and key in open_rows:
            end_ = event["at"] if event["event"] == "cleared" else None
            open_rows.pop(key).update(end=end_, length=event["active"])
    return rows


def other_rows(events: list[Record]) -> list[Record]:
    """Reboots, silences and the like one by one; what may come often as one row for each source and message."""
    rows: dict[tuple[object, ...], Record] = {}
    for number, event in enumerate(events):
        kind, length = event["kind"], event["length"] or 0.0
        if kind in ("fault", "unknown"):  # these have rows of their own
            continue
        what = str(EVENTS[kind].get("text", kind))
        if kind == "silence" and event["is_command"]:
            what = "Commands lost"
        elif kind == "bus":
            what = f"bus {str(event['what']).replace('_', ' ')}"
        elif kind == "invalid":
            what = f"{what}: {event['field']} {event['value']}"
        key = (number,) if EVENTS[kind].get("is_single") else (kind, event["who"], event["title"], what)
        row = rows.setdefault(key, _row(event, what, count=0, at=[]))
        row["count"] += event["count"] or 1
        row["at"].append(event["at"])
        row["end"] = event["at"]
        if kind in ("silence", "disabled"):
            is_open = kind == "disabled" and event["length"] is None
            row["end"], row["length"] = None if is_open else event["at"] + length, length
    return list(rows.values())


def filter_of(rows: list[Record], first: int, last: int) -> str:
    """Return the display filter of frames: those of the rows' IDs."""
    ids = sorted({row["id"] for row in rows if row["id"] is not None})
    bus = next((row["bus"] for row in rows if row["bus"]), None)
    parts = [f"frame.number >= {first}", f"frame.number <= {last}"]
    parts += [f'yapp.bus == "{bus}"'] if bus else []
    return " && ".join(parts + ([f"yapp.id in {{{', '.join(map(hex, ids))}}}"] if ids else []))


def joined(rows: list[Record]) -> list[Record]:
    """Join faults, silence and reboot of one controller that belong together to one incident, with its rows.

    A silence or a reboot is that of the message that comes most often: the others see it later.
    """
    found: list[Record] = []
    latest: dict[object, Record] = {}
    for row in sorted(rows, key=lambda row: float(row["begin"])):
        who = row["controller"] if EVENTS[row["kind"]].get("is_incident") else None
        incident = latest.get(who) if who else None
        if incident is None or (incident["until"] is not None and row["begin"] > incident["until"] + TOGETHER):
            incident = {"until": row["end"], "rows": []}
            found.append(incident)
            latest[who] = incident
        incident["rows"].append(row)
        incident["until"] = _last([incident["until"], row["end"]])
    for incident in found:
        rows = incident["rows"]
        fastest = min(row["every"] for row in rows)
        first = [row for row in rows if row["every"] == fastest or row["kind"] == "fault"]
        fault = next((row for row in rows if row["kind"] == "fault"), rows[0])
        incident |= {
            "begin": min(row["begin"] for row in first),
            "until": _last([row["end"] for row in first]),
            "kinds": sorted({row["kind"] for row in rows}),
            "what": ", ".join(dict.fromkeys(row["what"] for row in rows)),
            "is_fault": fault["kind"] == "fault",
            "is_serious": any(EVENTS[row["kind"]].get("is_serious") for row in rows),
            "source": fault["source"],
            "stopped": rows[0].get("stopped"),
        }
    return found


def _last(ends: list[float | None]) -> float | None:
    return None if None in ends else max(ends)  # type: ignore[type-var]
