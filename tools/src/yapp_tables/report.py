# SPDX-License-Identifier: GPL-2.0-or-later
"""One page with what went wrong and pictures of a capture; it opens offline, in any browser."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from . import cards
from .dataset import StrPath
from .errors import SetupError, need
from .flight import Flight, read_flight
from .incidents import events_of, excused, fault_rows, faults_in, filter_of, flag_of, joined, other_rows
from .limits import Limits
from .matrix import Matrix, multiples
from .pages import css, html_table
from .pictures import Pictures, Record, packed
from .scratch import write_whole
from .series import samples
from .sources import source_name
from .tshark import Tshark
from .verdict import head, merged, named

MARKS = 2_000  # of a lane and source
HIDDEN = ("id", "controller", "other")  # columns of the summary that the page does not show


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
    if not page.parent.is_dir():
        raise SetupError(f"{page} cannot be written: no folder {page.parent}")
    limits = Limits(Path(rules) if rules else None)
    flight = read_flight(capture, tshark, has_begin=True)
    count = faults_in(flight.events)
    told = cards.read(capture, tshark, range(1, min(count, cards.MOST) + 1))[0] if count else []
    try:
        write_report(flight, page, limits, told)
    except OSError as error:
        raise SetupError(f"{page} cannot be written: {error.strerror}") from error
    return page, flight


def write_report(flight: Flight, path: Path, limits: Limits, told: Sequence[Record] = ()) -> None:
    """Write the page of a flight to path; told: the cards of its faults. Raises OSError."""
    package = files(__package__)
    report = Report(flight, limits, told)
    found = report.data()
    blob = found.pop("blob")
    parts = {"/*MATRIX*/": report.matrix.html(), "/*MULTIPLES*/": report.multiples}
    parts |= head(found) | {"/*COLOURS*/": css()}
    units = {"rate": ", Hz", "gap_min": ", s", "gap_mean": ", s", "gap_max": ", s"}
    shown = (name for name in flight.summary.schema.names if name not in HIDDEN)
    heads = {name: f"{name.replace('_', ' ')}{units.get(name, '')}" for name in shown}
    summary = [row | {"source": source_name(row), "message": flight.title(row["message"])}
               for row in flight.summary.to_pylist()]  # fmt: skip
    parts |= {"/*SUMMARY*/": html_table(heads, summary)}
    parts |= {"/*DATA*/": json.dumps(found, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")}
    parts |= {"/*REPORT*/": package.joinpath("report.js").read_text(encoding="utf-8")}
    parts |= {"/*BLOB*/": blob, "/*PLOTLY*/": packed(need("plotly.offline", "report").get_plotlyjs().encode())}
    # Each mark once, from left to right: what stands for one may look like another.
    page = package.joinpath("report.html").read_text(encoding="utf-8")
    write_whole(path, re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark[0]], page))


class Report:
    """What the page shows, as JSON that report.js reads, and as tables.

    Seconds count from the flight's first packet, as in Wireshark.
    """

    def __init__(self, flight: Flight, limits: Limits, told: Sequence[Record]) -> None:
        """told: the cards of faults."""
        self.flight, self.limits, self.told, self.start = flight, limits, told, flight.start()
        self.end = max(pc.max(flight[name]["time"]).value - self.start for name in flight) / 1e9
        self.pictures = Pictures(limits)

    def data(self) -> Record:
        """Return it."""
        flight, pictures = self.flight, self.pictures
        rows = self._draw()
        for row in rows:
            pictures.source(row["source"], row)
        incidents = joined(rows)
        for row in incidents:
            cards_of = (card for card in self.told if any(one["frame"] == card["frame"] for one in row["rows"]))
            if row["is_fault"] and (card := next(cards_of, None)):
                row["card"] = f"<pre>{html.escape(card['text'])}</pre>"
        numbers = {source["name"]: number for number, source in enumerate(pictures.sources)}
        for row in [*incidents, *rows, *pictures.differs]:
            row["number"] = numbers.get(row["source"])
            row["label"] = row["source"] if row["number"] is None else pictures.sources[row["number"]]["label"]
        for row in incidents:
            self._lead(row)
            row["first"] = min(one["first"] for one in row["rows"])
            row["last"] = max(one["last"] for one in row["rows"])
            for each in (row, *row["rows"]):
                each["frames"] = f"{each['first']:,} to {each['last']:,}"
                each["filter"] = filter_of(each.get("rows", [each]), each["first"], each["last"])
        for row in pictures.differs:
            row["has_fault"] = any(_is_near(row, one) for one in incidents)
        self._tables(rows, incidents)
        controllers = len({source["controller"] for source in pictures.sources if not source["is_command"]})
        return {
            "name": flight.name,
            "epoch": self.start / 1e9,
            "length": self.end,
            "left_out": flight.left_out,
            "about": [
                ["plugin", flight.plugin], ["yapp-tables", version("yapp-tables")], ["catalogue", flight.catalogue]
            ],
            "incidents": sorted(incidents, key=lambda row: (not row["is_serious"], float(row["begin"]))),
            "differs": merged(pictures.differs, controllers),
            "flight": pictures.phases,
            "limits": pictures.limits_told(),
            "has_default_limits": self.limits.is_default,
            "rules": self.limits.name,
            "sources": pictures.sources,
            "names": list(numbers),
            "times": pictures.times,
            "figures": pictures.ordered(),
            "clouds": pictures.clouds,
            "lanes": self._lanes(rows),
            "blob": packed(bytes(pictures.bytes)),
        }  # fmt: skip

    def _lead(self, incident: Record) -> None:
        """Call an incident without a fault by that source of its controller that came first, the one with a name."""
        numbers = [row["number"] for row in incident["rows"] if row["number"] is not None]
        if numbers and not incident["is_fault"]:
            incident["number"] = min(numbers)
            source = self.pictures.sources[incident["number"]]
            incident |= {"source": source["name"], "label": source["label"]}

    def _tables(self, rows: list[Record], incidents: list[Record]) -> None:
        """The matrix, which counts incidents, and the small multiples."""
        sources, faults = self.pictures.sources, [row for row in rows if row["kind"] == "fault"]
        self.matrix = Matrix(self.pictures.messages, sources)
        known = [row for row in incidents if row["number"] is not None]
        for title, kind in (("Faults", "fault"), ("Silences", "silence"), ("Reboots", "reboot")):
            self.matrix.count(title, [row for row in known if any(one["kind"] == kind for one in row["rows"])])
        self.matrix.measure()
        bands: dict[int, list[tuple[float, float]]] = {}
        for row in faults:
            end = self.end if row["end"] is None else row["end"]
            bands.setdefault(sources[row["number"]]["controller"], []).append((row["begin"], end))
        named = {row["field"] for row in self.pictures.differs}
        self.multiples = multiples(self.pictures.messages, self.matrix, self.end, bands, named)

    def _draw(self) -> list[Record]:
        """Draw the flight; returns what went wrong."""
        flight = self.flight
        events = events_of(flight.events, flight.messages, self.start)
        sent = (row for row in flight.summary.to_pylist() if row["id"] is not None)
        windows = excused(events, {(row["bus"], row["id"]): source_name(row) for row in sent})
        found = samples(flight, start=self.start)
        # First the message that says most.
        for message in sorted(flight.messages, key=lambda name: -len(flight.messages[name])):
            flags = (flag_of(flight.messages, event) for event in events if event["message"] == message)
            own = [one for one in found.values() if one.message == message]
            self.pictures.add(own, {flag.name for flag in flags if flag}, windows)
        rows = fault_rows(flight.messages, events, self.end) + other_rows(events)
        self._frames(rows)
        self._stopped(rows)
        return rows

    def _frames(self, rows: list[Record]) -> None:
        """Say of each row in which frames it lies."""
        tables = self.flight.values()
        times = np.concatenate([table["time"].cast(pa.int64()).to_numpy() for table in tables])
        frames = np.concatenate([table["frame"].to_numpy() for table in tables])
        order = np.argsort(times, kind="stable")
        seconds, frames = (times[order] - self.start) / 1e9, frames[order]
        for row in rows:
            end = self.end if row["end"] is None else row["end"]
            first = min(int(np.searchsorted(seconds, row["begin"] - 1e-7)), len(frames) - 1)
            last = max(first, int(np.searchsorted(seconds, end + 1e-7, side="right")) - 1)
            row["first"], row["last"] = int(frames[first]), int(frames[last])

    def _stopped(self, rows: list[Record]) -> None:
        """Say of a Command that was lost or disabled which controllers of its bus lost speed."""
        pairs = [(one, pair[0]) for found in self.pictures.messages for one in found if (pair := one.speed())]
        for row in rows:
            if not (row["is_command"] and row["kind"] in ("silence", "disabled")):
                continue
            slowed, least = [], np.inf
            for one, name in pairs:
                speed = np.abs(one.columns[name])
                before = speed[(one.times > row["begin"] - 1) & (one.times <= row["begin"])]
                during = (one.times > row["begin"]) & (one.times < (row["end"] or self.end) + 0.5)
                if row["bus"] in {bus for bus, _ in one.ids} and len(before) and during.any():
                    low, usual = np.nanmin(speed[during]), np.nanmax(before)
                    if low < 0.9 * usual:
                        slowed.append(one.name)
                        least = min(least, low / usual)
            if slowed:
                word = "stopped" if least < 0.1 else f"slowed to {least:.0%} of their speed"
                row["stopped"] = f"{named(slowed)} {word}"

    def _lanes(self, rows: list[Record]) -> list[Record]:
        """A lane for each flag and kind of event on the time axis, faults first; what does not last is a mark."""
        lanes: dict[tuple[bool, str], Record] = {}
        for row in rows:
            is_fault = row["kind"] == "fault"
            about = {"title": row["what"], "message": row["message"] if is_fault else "", "rows": {}}
            lane = lanes.setdefault((not is_fault, row["what"]), about)
            begins = ends = row["at"][:: -(-len(row["at"]) // MARKS)]
            if is_fault or row["length"] or row["end"] is None:
                begins, ends = [row["begin"]], [self.end if row["end"] is None else row["end"]]
            number = row["number"]
            marks = lane["rows"].setdefault(number, {"source": number, "begins": [], "ends": []})
            marks["begins"] += begins
            marks["ends"] += ends
        return [
            lane | {"rows": list(lane["rows"].values())} for _, lane in sorted(lanes.items(), key=lambda one: one[0][0])
        ]


def _is_near(row: Record, incident: Record) -> bool:
    """Return whether a fault of the same controller comes with what differs."""
    until = np.inf if incident["until"] is None else incident["until"]
    is_its = incident["is_fault"] and incident["source"] == row["source"]
    return bool(is_its and incident["begin"] - 2 <= row["at"] <= until)
