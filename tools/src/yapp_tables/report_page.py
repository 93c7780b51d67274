# SPDX-License-Identifier: GPL-2.0-or-later
"""One page with what went wrong and pictures of a capture, which opens offline; and one fault for the vendor."""

import html
import io
import json
import re
import zipfile
from collections import Counter
from collections.abc import Iterable, Sequence
from decimal import Decimal
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from . import __version__
from .differs import Limits
from .errors import CaptureError, need
from .flight import Flight, StrPath, read_flight
from .incidents import events_of, excused, fault_rows, faults_in, filter_of, is_command, joined, other_rows
from .install import ask
from .matrix import Matrix
from .pictures import Pictures, packed
from .scratch import scratch, write_whole
from .series import Samples, controllers, natural, samples, source_name
from .tshark import Record, Tshark
from .verdict import head, merged, series_of

CARDS = 8  # of a page
STILL = 0.1  # of its highest speed: slower a controller does not turn
AROUND = 2  # seconds before a fault and behind its end
LONGEST = 20  # seconds: of a fault that stays, so much
LATER = 1  # seconds in which a message that began in time may end


def report(capture: StrPath, out: StrPath | None = None, *, rules: StrPath | None = None, **how: Any) -> Path:
    """Write the page of a capture.

    out: the page, None for one named as the capture; rules: a file of rules, whose ranges are limits in the pictures.
    Returns the page. Raises YappError.
    """
    return write_page(Path(capture), out, rules, Tshark(**how))[0]


def write_page(capture: Path, out: StrPath | None, rules: StrPath | None, tshark: Tshark) -> tuple[Path, Flight]:
    """Write as `report` does. Returns the page and its flight."""
    need("plotly", "report")
    page = Path(out) if out else capture.with_suffix(".html")
    limits = Limits(Path(rules) if rules else None)
    flight = read_flight(capture, tshark, has_begin=True)
    count = faults_in(flight.events)
    told = cards(capture, tshark, range(1, min(count, CARDS) + 1))[0] if count else []
    write_report(flight, page, limits, told, _least_margin(capture, Path(rules), tshark) if rules else "")
    return page, flight


def _least_margin(capture: Path, rules: Path, tshark: Tshark) -> str:
    """Say which value came nearest to the limit of its rule, or went farthest beyond it; "" for none."""
    text = rules.read_text(encoding="utf-8", errors="replace")
    rows = [row for row in tshark.ask(capture, ["check,rules=rules,json"], text)[0] if row.get("percent") is not None]
    least = min(rows, key=lambda row: row["percent"], default=None)
    if least is None:
        return ""
    margin = f"{least['margin']:.4g} ({least['percent']:.3g} %)"
    return f" Least margin: {margin} at the rule {least['rule']}, of {source_name(least)} in frame {least['frame']}."


def cards(capture: Path, tshark: Tshark, numbers: Iterable[int]) -> tuple[list[Record], list[str]]:
    """Return the cards of these faults, from 1, with `text` as of -z yapp,fault; and what the plugin says of them."""
    wanted = [f"fault,{number}{form}" for number in numbers for form in (",json", "")]
    rows, said, text = tshark.ask(capture, wanted)
    texts = re.split("(?m)^(?=YAPP fault: )", text)[1:]
    return [row | {"text": own} for row, own in zip(rows, texts, strict=False) if row.get("incident") is not None], said


def write_report(flight: Flight, path: Path, limits: Limits, told: Sequence[Record] = (), margin: str = "") -> None:
    """Write the page of a flight to path. told: the cards of its faults; margin: the least one. Raises SetupError."""
    start, pictures = flight.start(), Pictures(limits)
    length = max(pc.max(rows["time"]).value - start for rows in flight.values()) / 1e9
    events = events_of(flight.events, flight.messages, start)
    sent = (row for row in flight.summary.to_pylist() if row["id"] is not None)
    windows = excused(events, {(row["bus"], row["id"]): source_name(row) for row in sent})
    found = samples(flight, start=start)
    # First the message that says most.
    for message in sorted(flight.messages, key=lambda name: -len(flight.messages[name])):
        pictures.add([one for one in found.values() if one.message == message], windows)
    rows = fault_rows(flight.messages, events, length) + other_rows(events)
    for row in rows:
        row["stop"] = length if row["end"] is None else row["end"]
        pictures.source(row["source"], row, is_own=row["id"] is not None)
    _find_frames(flight, start, rows)
    _find_stopped(found.values(), rows)
    incidents = _of_buses(joined(rows), found.values())
    _name(incidents, rows, pictures)
    for row in (row for row in incidents if row["is_fault"]):
        frames = {one["frame"] for one in row["rows"]}
        row["card"] = next((f"<pre>{html.escape(one['text'])}</pre>" for one in told if one["frame"] in frames), "")
    matrix, named = Matrix(pictures.messages, pictures.sources), {row["field"] for row in pictures.differs}
    for title, kind in (("Faults", "fault"), ("Silences", "silence"), ("Reboots", "reboot")):
        matrix.count(title, [row for row in incidents if row["number"] is not None and kind in row["kinds"]])
    matrix.measure()
    bands: dict[int, list[tuple[float, float]]] = {}
    for row in (row for row in rows if row["kind"] == "fault"):
        bands.setdefault(pictures.sources[row["number"]]["controller"], []).append((row["begin"], row["stop"]))
    count = len({source["controller"] for source in pictures.sources if not source["is_command"]})
    about = [["plugin", flight.plugin], ["yapp-tables", __version__], ["catalogue", flight.catalogue]]
    for row in flight.buses.to_pylist():
        text = f"{row['frames']:,} frames, {row['yapp']:,} of YAPP, load {row['load'] or 0:.1%}"
        errors = json.loads(row["other"])["errors"].items()
        about.append([row["bus"] or "bus", "".join([text, *(f", {count} {what}" for what, count in errors if count)])])
    data = {
        "name": flight.name,
        "epoch": start / 1e9,
        "length": length,
        "left_out": flight.left_out,
        "about": about,
        "incidents": sorted(incidents, key=lambda row: (not row["is_serious"], float(row["begin"]))),
        "differs": merged(pictures.differs, count),
        "controllers": list(matrix.labels.values()),
        "flight": pictures.phases,
        "limits": [f"{one['title']} at most {one['limits'][1]:g} {one['unit']}" for one in pictures.figures
                   if limits.is_default and one["limits"][1] is not None],
        "margin": margin,
        "sources": pictures.sources,
        "times": pictures.times,
        "figures": pictures.ordered(),
        "clouds": pictures.clouds,
        "lanes": _lanes(rows),
    }  # fmt: skip
    package = Path(__file__).parent
    parts = head(data) | {
        "/*MATRIX*/": matrix.html(),
        "/*MULTIPLES*/": matrix.multiples(length, bands, named),
        "/*DATA*/": json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        "/*REPORT*/": package.joinpath("report.js").read_text(encoding="utf-8"),
        "/*BLOB*/": packed(bytes(pictures.bytes)),
        "/*PLOTLY*/": packed(need("plotly.offline", "report").get_plotlyjs().encode()),
    }
    # Each mark once, from left to right: what stands for one may look like another.
    page = package.joinpath("report.html").read_text(encoding="utf-8")
    write_whole(path, re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark[0]], page))


def _find_frames(flight: Flight, start: int, rows: list[Record]) -> None:
    """Say of each row in which frames it lies."""
    times = np.concatenate([table["time"].cast(pa.int64()).to_numpy() for table in flight.values()])
    frames = np.concatenate([table["frame"].to_numpy() for table in flight.values()])
    order = np.argsort(times, kind="stable")
    seconds, frames = (times[order] - start) / 1e9, frames[order]
    for row in rows:
        first = min(int(np.searchsorted(seconds, row["begin"] - 1e-7)), len(frames) - 1)
        last = max(first, int(np.searchsorted(seconds, row["stop"] + 1e-7, side="right")) - 1)
        row["first"], row["last"] = int(frames[first]), int(frames[last])


def _find_stopped(found: Iterable[Samples], rows: list[Record]) -> None:
    """Say of a Command that was lost or disabled which controllers of its bus lost speed."""
    for row in (row for row in rows if row["is_command"] and row["kind"] in ("silence", "disabled")):
        shares = {}  # of their speed, that is left
        for one in found:
            speed = np.abs(one.columns[pair[0]]) if (pair := one.speed()) else np.zeros(0)
            if len(speed) and row["bus"] in {bus for bus, _ in one.ids}:
                before = speed[(one.times > row["begin"] - 1) & (one.times <= row["begin"])]
                during = speed[(one.times > row["begin"]) & (one.times < row["stop"] + 0.5)]
                if len(during) and np.nanmax(before, initial=0.0) > STILL * np.nanmax(speed):
                    shares[one.name] = np.nanmin(during) / np.nanmax(before)
        slowed = {name: share for name, share in shares.items() if share < 0.9}
        if slowed:
            least = min(slowed.values())
            word = "stopped" if least < 0.1 else f"slowed to {least:.0%} of their speed"
            row["stopped"] = f"{series_of(list(slowed))} {word}"


def _of_buses(incidents: list[Record], found: Iterable[Samples]) -> list[Record]:
    """Join the silences of most controllers of a bus that begin within a second to one of the bus."""
    whose = {(bus, one.controller) for one in found if one.speed() or one.supply() for bus, _ in one.ids}
    sizes = Counter(bus for bus, _ in whose)
    kept = [row for row in incidents if row["kinds"] != ["silence"] or row["rows"][0]["is_command"]]
    rest = sorted((row for row in incidents if row not in kept), key=lambda row: float(row["begin"]))
    while rest:
        bus = rest[0]["rows"][0]["bus"]
        whole = [row for row in rest if row["rows"][0]["bus"] == bus and row["begin"] <= rest[0]["begin"] + 1]
        rest = [row for row in rest if row not in whole]
        if len(whole) < max(2, 2 / 3 * sizes[bus]):
            kept += whole
            continue
        ends, names = [row["until"] for row in whole], sorted((row["source"] for row in whole), key=natural)
        who = f"all {len(whole)} controllers" if len(whole) == sizes[bus] else series_of(names)
        about = {"bus": bus, "source": bus, "what": f"silence of {who}", "until": None if None in ends else max(ends)}
        kept.append(whole[0] | about | {"rows": [one for row in whole for one in row["rows"]]})
    return kept


def _name(incidents: list[Record], rows: list[Record], pictures: Pictures) -> None:
    """Give incidents, rows and differences the number and label of their source, and incidents their frames."""
    sources = pictures.sources
    numbers = {source["name"]: number for number, source in enumerate(sources)}
    for row in [*incidents, *rows, *pictures.differs]:
        row["number"] = numbers.get(row["source"])
        row["label"] = row["source"] if row["number"] is None else sources[row["number"]]["label"]
    for row in incidents:
        known = [one["number"] for one in row["rows"] if one["number"] is not None]
        if known and not row["is_fault"] and "bus" not in row:
            # That source of its controller which came first, the one with a name.
            lead = sources[min(known)]
            row |= {"number": min(known), "source": lead["name"], "label": lead["label"]}
        row["first"], row["last"] = min(one["first"] for one in row["rows"]), max(one["last"] for one in row["rows"])
        for each in (row, *row["rows"]):
            each["frames"] = f"{each['first']} to {each['last']}"
            each["filter"] = filter_of(each.get("rows", [each]), each["first"], each["last"])
    for row in pictures.differs:  # whether a fault of the same controller comes with it
        its = [one for one in incidents if one["is_fault"] and one["source"] == row["source"]]
        ends = [(one["begin"] - 2, np.inf if one["until"] is None else one["until"]) for one in its]
        row["has_fault"] = any(begin <= row["at"] <= end for begin, end in ends)


def _lanes(rows: list[Record]) -> list[Record]:
    """A lane for each flag and kind of event on the time axis, faults first; what does not last is a mark."""
    lanes: dict[str, Record] = {}
    for row in sorted(rows, key=lambda row: row["kind"] != "fault"):
        is_fault = row["kind"] == "fault"
        about = {"title": row["what"], "message": row["message"] if is_fault else "", "rows": {}}
        own = lanes.setdefault(row["what"], about)["rows"]
        marks = own.setdefault(row["number"], {"source": row["number"], "begins": [], "ends": []})
        lasts = is_fault or row["length"] or row["end"] is None
        marks["begins"] += [row["begin"]] if lasts else row["at"]
        marks["ends"] += [row["stop"]] if lasts else row["at"]
    return [lane | {"rows": list(lane["rows"].values())} for lane in lanes.values()]


# ---- one fault for the vendor: its frames, its card, the page and the versions, in one zip


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
    versions = {
        "case": f"fault {number} of {capture.name}: {about}",
        "capture": f"{capture.name}, SHA-256 {flight.flight_id}...",
        "plugin": flight.plugin,
        "yapp-tables": __version__,
        "tshark": ask(tshark.find(), "--version")[0].splitlines()[0],
        "catalogue": flight.catalogue,
        "options": " ".join(tshark.options) or "none",
        "not decoded": "; ".join(flight.left_out) or "nothing",
    }
    with scratch() as folder:
        part, page = folder / "frames.pcapng", folder / "page.html"
        # Of 3, 7, 8 and 9 the filter has 3..3, 7..9.
        spans = [[frame for _, frame in span] for _, span in groupby(enumerate(frames), lambda pair: pair[1] - pair[0])]
        ranges = ", ".join(f"{span[0]}..{span[-1]}" for span in spans)
        tshark.run(capture, ["-Y", f"frame.number in {{{ranges}}}", "-w", str(part)])
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
