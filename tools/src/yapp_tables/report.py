# SPDX-License-Identifier: GPL-2.0-or-later
"""One page with what went wrong and pictures of a capture; it opens offline, in any browser."""

from __future__ import annotations

import html
import itertools
import json
import re
from collections.abc import Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from plotly.offline import get_plotlyjs
from tqdm import tqdm

from . import cards
from .api import read_flight
from .config import Config, StrPath
from .dataset import plain_name
from .errors import SetupError
from .flight import Flight
from .html_table import html_table
from .incidents import events_of, excused, fault_rows, faults_in, filter_of, flag_of, joined, other_rows
from .limits import Limits
from .matrix import Matrix
from .multiples import Multiples
from .palette import css
from .pictures import MARKS, Pictures, Record, first_of, overlaid, packed
from .scratch import write_whole
from .sources import source_name
from .verdict import causes, head, headline, merged, named

LANES = ("fault", "event", "enum", "flag")
VALUES = {"message": "message", "title": "field", "unit": "unit", "source": "source"}
VALUES |= {name: name for name in ("min", "mean", "max")}


def write_reports(
    captures: Sequence[Path],
    config: Config,
    out: StrPath | None = None,
    overlay: bool = False,
    rules: StrPath | None = None,
) -> tuple[Path, list[Record]]:
    """Write the page of a flight, one page of several laid over each other, or a folder of pages with an index.

    rules: a file of rules for -z yapp,check, whose ranges are limits. Returns the page, and what each page says.
    Raises YappError.
    """
    page = captures[0].with_suffix(".html") if out is None else Path(out)
    limits = Limits(Path(rules) if rules else None)
    is_one = len(captures) == 1 or overlay
    folder = page.parent if is_one else Path("report" if out is None else out)
    try:
        if is_one:
            if not folder.is_dir():
                raise SetupError(f"{page} cannot be written: no folder {folder}")
            return page, [write_report([_read(capture, config) for capture in captures], page, limits)]
        folder.mkdir(parents=True, exist_ok=True)
        rows = []
        for flight in (_read(capture, config) for capture in tqdm(captures, unit="flight", disable=None)):
            name = f"{plain_name(Path(flight.name))}-{flight.flight_id[:8]}.html"
            rows.append(write_report([flight], folder / name, limits) | {"page": name})
        write_whole(folder / "index.html", _index(rows))
        return folder / "index.html", rows
    except OSError as error:
        raise SetupError(f"{page} cannot be written: {error.strerror}") from error


def _read(capture: Path, config: Config) -> Flight:
    tshark, aircraft = config.of(capture)
    flight = read_flight(capture, tshark, has_begin=True)
    flight.aircraft = aircraft
    if count := faults_in(flight.events):
        flight.cards, _ = cards.read(capture, tshark, range(1, min(count, cards.MOST) + 1))
    return flight


def write_report(flights: Sequence[Flight], path: Path, limits: Limits | None = None) -> Record:
    """Write the page of a flight, or of several laid over each other, to path. Returns what it says. Raises OSError."""
    package = files(__package__)
    page = package.joinpath("report.html").read_text(encoding="utf-8")
    report = Report(flights, limits)
    found = report.data()
    blob = found.pop("blob")
    parts = {"/*MATRIX*/": report.matrix.html(), "/*MULTIPLES*/": report.multiples.html(report.matrix.labels)}
    parts |= head(found) | {"/*COLOURS*/": css()}
    parts |= {"/*VALUES*/": html_table(VALUES, [row for flight in flights for row in _values(flight)])}
    heads = {name: text for flight in flights for name, text in flight.heads.items()}
    parts |= {"/*SUMMARY*/": html_table(heads, [row for flight in flights for row in flight.sources()])}
    parts |= {"/*DATA*/": json.dumps(found, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")}
    parts |= {"/*REPORT*/": package.joinpath("report.js").read_text(encoding="utf-8")}
    parts |= {"/*BLOB*/": blob, "/*PLOTLY*/": packed(get_plotlyjs().encode())}
    # Each mark once, from left to right: what stands for one may look like another.
    page = re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark[0]], page)
    write_whole(path, page)
    return found


class Report:
    """What the page shows, as JSON that report.js reads, and as tables. Of several flights, each begins at 0 s."""

    def __init__(self, flights: Sequence[Flight], limits: Limits | None = None) -> None:
        """flights: with `begin`, seconds count from the first packet as in Wireshark, else from the first message."""
        self.flights, self.end, self.limits = flights, 0.0, limits or Limits()
        self.starts = [_start(flight) for flight in flights]
        self.pictures = Pictures(0, self.limits, sum(map(_signals, flights)))

    def data(self) -> Record:
        """Return it."""
        rows: list[Record] = []
        incidents: list[Record] = []
        for flight, start in zip(self.flights, self.starts, strict=True):
            found = self._add(flight, start, f"{flight.name}: " if len(self.flights) > 1 else "")
            incidents += joined(found)
            for card, row in itertools.product(flight.cards, incidents):
                if row["is_fault"] and any(one["frame"] == card["frame"] for one in row["rows"]):
                    row["card"] = cards.panel(card, flight.messages)
            rows += found
            self.pictures.flight += 1
        first, pictures = self.flights[0], self.pictures
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
            "name": " and ".join(flight.name for flight in self.flights),
            "epoch": self.starts[0] / 1e9,
            "length": self.end,
            "left_out": [text for flight in self.flights for text in flight.left_out],
            "partial": any(flight.partial for flight in self.flights),
            "about": [["plugin", first.plugin], ["yapp-tables", version("yapp-tables")], *self._about()],
            "incidents": sorted(incidents, key=lambda row: (not row["is_serious"], float(row["begin"]))),
            "differs": merged(pictures.differs, controllers),
            "flight": pictures.phases if len(self.flights) == 1 else [],
            "limits": pictures.limits_told(),
            "has_default_limits": self.limits.is_default,
            "rules": self.limits.name,
            "sources": pictures.sources,
            "names": list(numbers),
            "times": pictures.times,
            "figures": pictures.ordered(),
            "clouds": overlaid(pictures.clouds),
            "lanes": sorted(
                overlaid(pictures.lanes), key=lambda lane: ("fault", "event", "enum", "flag").index(lane["kind"])
            ),
            "level": pictures.level,
            "blob": pictures.blob(),
        }

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
        self.matrix = Matrix(self.pictures.parts, sources, self.limits)
        known = [row for row in incidents if row["number"] is not None]
        for title, kind in (("Faults", "fault"), ("Silences", "silence"), ("Reboots", "reboot")):
            self.matrix.count(title, [row for row in known if any(one["kind"] == kind for one in row["rows"])])
        self.matrix.measure()
        bands: dict[int, list[tuple[float, float]]] = {}
        for row in faults:
            end = self.end if row["end"] is None else row["end"]
            bands.setdefault(sources[row["number"]]["controller"], []).append((row["begin"], end))
        self.multiples = Multiples(sources, self.end, bands)
        for part in self.pictures.parts:
            self.multiples.add(part, {row["field"] for row in self.pictures.differs})

    def _about(self) -> list[list[str]]:
        """Return board revisions and the like: fields of a message that name a revision or a version."""
        first = self.flights[0]
        names = (row for row in _values(first) if re.search("(?i)revision|version", row["title"]))
        found = [[name, str(value)] for name, value in {(row["title"].lower(), f"{row['max']:g}") for row in names}]
        return [*found, ["catalogue", first.catalogue], *([["aircraft", first.aircraft]] if first.aircraft else [])]

    def _add(self, flight: Flight, start: int, prefix: str) -> list[Record]:
        """Draw a flight; returns what went wrong."""
        self.pictures.start = start
        self.end = max(self.end, max(pc.max(flight[name]["time"]).value - start for name in flight) / 1e9)
        events = events_of(flight.events, flight.messages, start, flight.title, prefix)
        sent = (row for row in flight.summary.to_pylist() if row["id"] is not None)
        windows = excused(events, {(row["bus"], row["id"]): source_name(row) for row in sent})
        # First the message that says most.
        for message in sorted(flight.messages.values(), key=lambda message: -len(message.columns)):
            flags = (flag_of(flight.messages, event) for event in events if event["message"] == message.name)
            alarms = {flag.name for flag in flags if flag}
            self.pictures.add(message, flight[message.name], alarms, windows, prefix)
        rows = fault_rows(flight.messages, events, self.end) + other_rows(flight.messages, events)
        self._frames(flight, rows, start)
        self._stopped(rows, prefix)
        self._marks([row for row in rows if row["kind"] != "fault"])
        return rows

    def _frames(self, flight: Flight, rows: list[Record], start: int) -> None:
        """Say of each row in which frames it lies, and the filter that finds them."""
        times = np.concatenate([flight[name]["time"].cast(pa.int64()).to_numpy() for name in flight])
        frames = np.concatenate([flight[name]["frame"].to_numpy() for name in flight])
        order = np.argsort(times, kind="stable")
        seconds, frames = (times[order] - start) / 1e9, frames[order]
        for row in rows:
            end = self.end if row["end"] is None else row["end"]
            first = min(int(np.searchsorted(seconds, row["begin"] - 1e-7)), len(frames) - 1)
            last = max(first, int(np.searchsorted(seconds, end + 1e-7, side="right")) - 1)
            row["first"], row["last"] = int(frames[first]), int(frames[last])

    def _stopped(self, rows: list[Record], prefix: str) -> None:
        """Say of a Command that was lost or disabled which controllers of its bus lost speed."""
        for row in rows:
            part = next((part for part in self.pictures.parts if part.speed()), None)
            if not (row["is_command"] and row["kind"] in ("silence", "disabled") and part):
                continue
            column = part.speed()
            assert column
            slowed, least = [], np.inf
            for source, speed in zip(part.found, part.values[column[0].name], strict=True):
                before = np.abs(speed[(source.times > row["begin"] - 1) & (source.times <= row["begin"])])
                during = (source.times > row["begin"]) & (source.times < (row["end"] or self.end) + 0.5)
                if first_of(source)["bus"] == row["bus"] and len(before) and during.any():
                    low, usual = np.nanmin(np.abs(speed[during])), np.nanmax(before)
                    if low < 0.9 * usual:
                        slowed.append(prefix + source.name)
                        least = min(least, low / usual)
            if slowed:
                word = "stopped" if least < 0.1 else f"slowed to {least:.0%} of their speed"
                row["stopped"] = f"{named(slowed)} {word}"

    def _marks(self, others: list[Record]) -> None:
        """The events on the time axis: a lane for each kind and source; one that does not last is a mark."""
        lanes: dict[str, Record] = {}
        for row in others:
            lane = lanes.setdefault(
                row["what"], {"title": row["what"], "message": "", "key": "", "kind": "event", "rows": {}}
            )
            source = self.pictures.source(row["source"], row)
            marks = lane["rows"].setdefault(source, {"source": source, "texts": [], "begins": [], "ends": []})
            at = row["at"][:: -(-len(row["at"]) // MARKS)]
            marks["begins"] += at
            marks["ends"] += [row["end"]] if row["length"] else at
        self.pictures.lanes += [lane | {"rows": list(lane["rows"].values())} for lane in lanes.values()]


def _start(flight: Flight) -> int:
    return flight.begin or min(pc.min(flight[name]["time"]).value for name in flight)


def _is_near(row: Record, incident: Record) -> bool:
    """Return whether a fault of the same controller comes with what differs."""
    until = np.inf if incident["until"] is None else incident["until"]
    is_its = incident["is_fault"] and incident["source"] == row["source"]
    return bool(is_its and incident["begin"] - 2 <= row["at"] <= until)


def _signals(flight: Flight) -> int:
    """About how many lines there are: values, of each source."""
    return sum(
        sum(column.role == "value" for column in message.columns.values())
        * flight[name].group_by(["bus", "id"]).aggregate([]).num_rows
        for name, message in flight.messages.items()
    )


def _values(flight: Flight) -> list[Record]:
    """A row for each field of each source: of one field those of all sources stand together."""
    rows = []
    for row in sorted(flight.statistics.to_pylist(), key=lambda row: (row["message"], row["field"])):
        message = flight.messages.get(row["message"])
        column = message.columns.get(row["field"]) if message else None
        about = {"message": flight.title(row["message"]), "source": source_name(row)}
        about |= {"title": column.title if column else row["field"], "unit": column.unit if column else ""}
        rows += [row | about] if row["min"] is not None else []
    return rows


def _index(found: list[Record]) -> str:
    """The page of a folder: a row for each flight, what went wrong first."""
    lines = []
    for data in sorted(found, key=lambda data: float(data["epoch"])):
        said = [*data["left_out"], ": ".join(headline(data))]
        said += [f"{one['who']}: {'; '.join(each['text'] for each in one['said'])}" for one in causes(data)[:5]]
        cells = [
            f"<td>{html.escape(text)}</td>" for text in (f"{len(data['incidents'])}", "; ".join(said) or "nothing")
        ]
        link = f"<a href='{html.escape(data['page'])}'>{html.escape(data['name'])}</a>"
        time = f"<td data-epoch={data['epoch']} data-length={data['length']}></td>"
        lines.append(f"<tr><td>{link}</td>{time}{''.join(cells)}</tr>")
    template = files(__package__).joinpath("index.html").read_text(encoding="utf-8")
    return template.replace("<!--ROWS-->", "\n".join(lines))
