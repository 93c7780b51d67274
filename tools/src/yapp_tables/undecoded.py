# SPDX-License-Identifier: GPL-2.0-or-later
"""Say which messages of a capture were not decoded, and which preference decodes them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

Record = dict[str, Any]


def source_name(row: Record) -> str:
    """Return the user's name for a source, else its bus and ID: `can0 0x210`; of what has none, all of the capture."""
    number = "" if row.get("id") is None else f"0x{row['id']:03x}"
    return row.get("source") or " ".join(part for part in (row.get("bus"), number) if part) or "capture"


def undecoded(events: Sequence[Record], summary: Sequence[Record], titles: dict[str, str], said: str) -> str:
    """Return a sentence on the events of kind `unknown`, empty where there are none.

    summary: the lines of the statistic `summary`; titles: {message: title}; said: stderr, on which the plugin suggests
    what to set: `Try -o yapp.motor_ids:0x210-0x213`.
    """
    unknown = [event for event in events if event["kind"] == "unknown"]
    if not unknown:
        return ""
    names = {title: name for name, title in titles.items()}
    kinds: dict[tuple[str, int], list[Record]] = {}
    for event in unknown:
        like = names.get(event.get("like") or "", event.get("like") or "")
        kinds.setdefault((like, 0 if like else event["size"]), []).append(event)
    details = []
    for (like, size), group in kinds.items():
        count = sum(event["count"] for event in group)
        ids = sorted({event["id"] for event in group if event["id"] is not None})
        who = ", ".join(f"0x{number:03x}" for number in ids) or ", ".join(sorted(set(map(source_name, group))))
        verb = "has" if count == 1 else "have"
        known = titles.get(group[0].get("message") or "")
        what = f"{size} bytes, not the size of {known}" if known else f"{size} bytes, which no message has"
        what = f"the size of {titles.get(like, like)}" if like else what
        details.append(f"{count} message{'s' * (count != 1)} of {who} {verb} {what}")
    lost = {source_name(event) for event in unknown}
    total = len(lost.union(map(source_name, summary)))
    found = re.search(r"\. Try -o (.*)", said)
    advice = f": set {found[1].replace(' or -o ', ' or ').replace(' -o ', ' and ')}" if found else ""
    some = {
        source_name(row)
        for row in summary
        if any(each["min"] is not None for each in (row.get("values") or {}).values())
    }
    how = "not decoded" if not lost & some else "decoded in part" if lost <= some else "not decoded, or in part"
    verb = "was" if len(lost) == 1 else "were"
    return f"{len(lost)} of {total} source{'s' * (total != 1)} {verb} {how} ({'; '.join(details)}){advice}"


def left_out(partial: str | None, lost: str, complaints: Iterable[str]) -> list[str]:
    """Return sentences on all that a result lacks; empty where it is complete."""
    return [text for text in (f"read in part: {partial}" if partial else "", lost, *complaints) if text]
