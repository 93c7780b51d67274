# SPDX-License-Identifier: GPL-2.0-or-later
"""One fault for the vendor: its frames, its card, the page of the flight and the versions, in one zip."""

from __future__ import annotations

import hashlib
import io
import json
import platform
import zipfile
from collections.abc import Iterable
from decimal import Decimal
from importlib.metadata import version
from pathlib import Path

from .differs import Limits
from .errors import CaptureError
from .flight import Flight, read_flight
from .incidents import is_command
from .install import ask
from .report import cards, write_report
from .scratch import scratch, write_whole
from .series import controllers
from .tshark import Record, Tshark

AROUND = 2  # seconds before a fault and behind its end
LONGEST = 20  # seconds: of a fault that stays, so much
LATER = 1  # seconds in which a message that began in time may end


def write_case(capture: Path, number: int, tshark: Tshark, out: Path) -> str:
    """Write the zip of a fault, 1 for the first; returns what is in it. Raises YappError."""
    flight = read_flight(capture, tshark, has_begin=True)
    told, said = cards(capture, tshark, [number])
    card = next((one for one in told if one["incident"] == number), None)
    if card is None:
        raise CaptureError("; ".join([f"{capture} has no fault {number}: -z yapp,faults lists all", *said]))
    begin = Decimal(str(card["time"])) - AROUND
    end = begin + AROUND * 2 + Decimal(min(float(card["active"] or LONGEST), LONGEST))
    frames = _frames(capture, tshark, card, flight, begin, end)
    who = card["source"] or f"{card['bus'] or ''} {card['id']:#x}".strip()
    about = f"{len(frames)} frames of {who}, its Commands and bus errors, {AROUND} s around the fault"
    versions = {"case": f"fault {number} of {capture.name}: {about}", **_versions(capture, tshark, flight)}
    with scratch() as folder:
        part, page = folder / "frames.pcapng", folder / "page.html"
        tshark.run(capture, ["-Y", f"frame.number in {{{_ranges(frames)}}}", "-w", str(part)])
        if not part.is_file():
            raise CaptureError(f"{capture}: tshark wrote no frames of fault {number}; try -z yapp,fault,{number}")
        write_report(flight, page, Limits(), told)
        files = {
            "card.txt": card.pop("text").encode(),
            "card.json": json.dumps(card, indent=1, default=float).encode(),
            "versions.txt": "".join(f"{key}: {value}\n" for key, value in versions.items()).encode(),
            part.name: part.read_bytes(),
            page.name: page.read_bytes(),
        }
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    write_whole(out, whole.getvalue())
    return f"{about}; {', '.join(files)}"


def _frames(capture: Path, tshark: Tshark, card: Record, flight: Flight, begin: Decimal, end: Decimal) -> list[int]:
    """Return the frames of all IDs of the controller, its Commands and bus errors, with all of each message."""
    rows = flight.summary.to_pylist()
    whose = dict(zip(((row["bus"], row["id"]) for row in rows), controllers(rows), strict=True))
    own = whose.get((card["bus"], card["id"]))
    ids = [row["id"] for row in rows if row["id"] is not None and row["bus"] == card["bus"]
           and (whose[row["bus"], row["id"]] == own or is_command(flight.messages, row["message"]))]  # fmt: skip
    wanted = f"yapp.id in {{{', '.join(map(hex, ids))}}}"
    wanted += f' && yapp.bus == "{card["bus"]}"' if card["bus"] else ""
    # A message that came in segments needs all packets.
    which = f"(({wanted}) || can.flags.err == 1 || !can)"
    window = f"frame.time_epoch >= {begin:.9f} && frame.time_epoch <= {end + LATER:.9f}"
    names = ("frame.number", "frame.time_epoch", "yapp.fragment")
    options = [word for name in names for word in ("-e", name)]
    frames: set[int] = set()
    for line in tshark.run(capture, ["-Y", f"{which} && {window}", "-T", "fields", *options]).splitlines():
        number, time, parts = line.split("\t")
        fragments = {int(each) for each in parts.split(",") if each}
        if Decimal(time) <= end or fragments & frames:
            frames |= {int(number), *fragments}
    return sorted(frames)


def _ranges(frames: Iterable[int]) -> str:
    """Return `3, 7..9` for 3, 7, 8 and 9."""
    spans: list[list[int]] = []
    for frame in frames:
        if spans and frame == spans[-1][1] + 1:
            spans[-1][1] = frame
        else:
            spans.append([frame, frame])
    return ", ".join(f"{first}" if first == last else f"{first}..{last}" for first, last in spans)


def _versions(capture: Path, tshark: Tshark, flight: Flight) -> Record:
    with capture.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "capture": capture.name,
        "sha256": digest,
        "plugin": flight.plugin,
        "yapp-tables": version("yapp-tables"),
        "tshark": ask(tshark.find(), "--version")[0].splitlines()[0],
        "python": platform.python_version(),
        "catalogue": flight.catalogue,
        "options": " ".join(tshark.options) or "none",
        "not decoded": "; ".join(flight.left_out) or "nothing",
    }
