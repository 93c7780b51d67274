# SPDX-License-Identifier: GPL-2.0-or-later
"""The pictures of a page: figures of values, and what one value does over another."""

import base64
import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .differs import Found, Limits, Windows, beyond, calm_samples, differing, flying, sagging
from .series import DEGREES, Array, thin
from .tshark import Record

# What the page keeps of a signal of one source: 20 minutes at 10 Hz. It thins that to what its window has room for.
SAMPLES = 12_000
CLOUD = 500  # points of one source, and of its largest values
CLOUD_ENDS = 20
COLOURS, IDS_OF_A_BUS = 16, 8


@dataclass
class Pictures:
    """What report.js draws, as JSON.

    sources: {name, label, colour, controller} of each; times: the x axes that lines share; figures, clouds: [{title,
    unit, message, key, lines, limits}]; differs: who is different from the others; messages: for tables that are made
    elsewhere; phases: in flight.
    """

    limits: Limits
    sources: list[Record] = field(default_factory=list)
    messages: list[Found] = field(default_factory=list)
    times: list[Record] = field(default_factory=list)
    figures: list[Record] = field(default_factory=list)
    clouds: list[Record] = field(default_factory=list)
    differs: list[Record] = field(default_factory=list)
    phases: list[tuple[float, float]] = field(default_factory=list)
    bytes: bytearray = field(default_factory=bytearray)
    _leads: dict[object, Record] = field(default_factory=dict)  # the first source of each controller

    def add(self, found: Found, excused: Mapping[str, Windows]) -> None:
        """Draw a message of all sources, that with the speed first. excused: of sources, when they are not compared."""
        self.phases = flying(found) or self.phases
        for one in found:
            bus, number = next(iter(one.ids))
            # A message without a clock of the controller, such as a command, may be for all of a bus.
            one.number = self.source(one.name, {"bus": bus, "id": number}, one.title, bool(one.names("clock")))
            one.flying = calm_samples(one, self.phases, ())
            one.calm = calm_samples(one, self.phases, excused.get(one.name, ()))
        self.messages.append(found)
        names = found[0].names("value")
        limited = [row for name in names for one in found for row in beyond(one, name, self.limits.of(one, name))]
        self.differs += [*differing(found), *limited, *sagging(found, self.phases)]
        self._cloud(found)
        self._figures(found, names)

    def source(self, name: str, row: Record, title: str = "", is_own: bool = True) -> int:
        """Return the number of a source. title: of its message; is_own: whether only this controller sends that."""
        known = [source["name"] for source in self.sources]
        if name in known:
            return known.index(name)
        bus, of_bus = row.get("bus") or "", row.get("id")
        key = name if of_bus is None or not is_own else (bus, of_bus & 0xF)
        lead = self._leads.get(key)
        label = f"{name} ({bus})" if bus and not name.startswith(bus) else name
        # A source that has no name of the user's is called by the controller's, if that has one.
        if lead and lead["label"] not in (lead["name"], name) and label == name:
            label = f"{lead['label']}, {title or name}"
        # The same colour for the same controller in every flight: by the end of its ID, and its bus's number.
        end = bus[len(bus.rstrip("0123456789")) :] or 0
        colour = ((of_bus or 0) % IDS_OF_A_BUS + IDS_OF_A_BUS * int(end)) % COLOURS if is_own else "command"
        about = {"name": name, "label": label, "colour": colour}
        about |= {"is_command": not is_own, "controller": lead["controller"] if lead else len(self._leads)}
        self.sources.append(about)
        self._leads.setdefault(key, about)
        return len(known)

    def ordered(self) -> list[Record]:
        """Return the figures: speed, current of the supply, motor temperature and voltage first."""
        first: list[str] = []
        for one in (found[0] for found in self.messages):
            volts, amperes = one.supply() or ("", "")
            wanted = [*(one.speed() or ())[:1], amperes, *one.measured(*DEGREES)[:1], volts]
            first += [f"{one.message}.{name}" for name in wanted]
        return sorted(self.figures, key=lambda one: first.index(one["key"]) if one["key"] in first else len(first))

    def _figures(self, found: Found, names: Sequence[str]) -> None:
        """A figure for each value of all sources, with its command."""
        ends = {name: [(np.nanmin(one.columns[name], initial=np.inf), np.nanmax(one.columns[name], initial=-np.inf))
                       for one in found] for name in names}  # fmt: skip
        drawn = [name for name in names if any(low < high for low, high in ends[name])]
        figures, lead = {}, found[0]
        for name in drawn:
            lows, highs = zip(*(self.limits.of(one, name) for one in found), strict=True)
            limits = [end if np.isfinite(end) else None for end in (max(lows), min(highs))]  # the narrowest
            about: Record = {"title": lead.title_of(name), "unit": lead.unit_of(name), "message": lead.title}
            figures[name] = about | {"limits": limits, "key": f"{lead.message}.{name}", "lines": list[Record]()}
            self.figures.append(figures[name])
        for one in found if drawn else ():
            times, lines = thin(one, [one.columns[name] for name in drawn], SAMPLES)
            self.times.append(self._keep(np.diff(np.round(times * 1e6), prepend=0), "<i4"))
            line = {"source": one.number, "x": len(self.times) - 1}
            for name, own in zip(drawn, lines, strict=True):
                figures[name]["lines"].append(line | {"name": one.title_of(name), "y": self._keep(own, "<f4")})
        for name, figure in figures.items():
            both = {name, name.replace("_measured", "_commanded")}
            for told in both & figures.keys() - {name}:
                figure["lines"] = [asked | {"dash": "dash"} for asked in figures[told]["lines"]] + figure["lines"]
                self.figures.remove(figures[told])
            odd = {row["source"] for row in self.differs if row["field"] in both and row["kind"] != "left"}
            figure["odd"] = sorted({self.sources[one.number]["controller"] for one in found if one.name in odd})

    def _cloud(self, found: Found) -> None:
        """Current over speed, a cloud a source; it says whose level is odd, and how odd."""
        lead, pair, speeds = found[0], found[0].supply(), found[0].speed()
        if not pair or not speeds:
            return
        title, lines, odd, said = f"{lead.title_of(pair[1])} over {lead.title_of(speeds[0])}", [], [], []
        for one in found:
            across, up = one.columns[speeds[0]], one.columns[pair[1]]
            good = np.flatnonzero(np.isfinite(across) & np.isfinite(up))
            if len(good):
                order = good[np.argsort(up[good])]
                ends = np.concatenate([order[:CLOUD_ENDS], order[-CLOUD_ENDS:]])
                kept = np.unique(np.concatenate([good[:: -(-len(good) // CLOUD)], ends]))
                points = {"x": self._keep(across[kept], "<f4"), "y": self._keep(up[kept], "<f4")}
                lines.append({"source": one.number, "name": title} | points)
        sources = {source["name"]: source for source in self.sources}
        for row in (row for row in self.differs if row["kind"] == "level" and row["field"] == pair[1]):
            source = sources[row["source"]]
            odd.append(source["controller"])
            said.append(f"{source['label']}, {row['value']:.1f} beside {row['beside']:.1f} {row['unit']}")
        about = {"title": title, "message": lead.title, "key": "", "lines": lines, "unit": lead.unit_of(pair[1])}
        about |= {"across": f"{lead.title_of(speeds[0])}, {lead.unit_of(speeds[0])}"}
        self.clouds.append(about | {"odd": odd, "said": "; ".join(said)})

    def _keep(self, values: Array, kind: str) -> Record:
        """Keep samples, all first bytes, then all second ones: so they pack well."""
        data = np.frombuffer(values.astype(kind).tobytes(), np.uint8).reshape(-1, 4).T.tobytes()
        self.bytes += data
        return {"at": len(self.bytes) - len(data), "count": len(values)}


def packed(data: bytes) -> str:
    """Return bytes as gzip in base64, the same each time."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()
