# SPDX-License-Identifier: GPL-2.0-or-later
"""Many flights, one trend: of each controller what drifts from flight to flight at equal load. docs/compare.md."""

from __future__ import annotations

import html
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from tqdm import tqdm

from . import pages
from .errors import SetupError, count_of
from .follow import SHAPES, Following
from .intervals import lowest, slope
from .load import Load
from .series import DEGREES, Array, Samples, samples
from .tables import SCHEMA

LEAST_FLIGHTS, LEAST_SECONDS = 5, 20.0
CHANCE = 0.02  # that one of all slopes is called a drift by chance
# The least drift over all flights that counts: relative, in the unit, in seconds, a share.
LEAST = {"A": 0.02, "°C": 2.0, "%": 3.0, "lag": 0.02, "sag": 0.02, "lost": 0.002}
LAGS = np.arange(-0.2, 0.8, 0.02)
EVERY = 1.0  # seconds: means of so long are compared
Key = tuple[str, str, str, str]  # controller, title, unit, key of LEAST


@dataclass
class Drift:
    """A value of a controller over its flights. flights: their names; values: (n); per_flight, low, high: the slope and
    its 95 % interval; is_sure: whether it drifts, judged for all values together."""

    controller: str
    title: str
    unit: str
    flights: list[str]
    values: Array
    per_flight: float
    low: float
    high: float
    is_sure: bool

    def sentence(self) -> str:
        """Return it for people."""
        count = len(self.values)
        whole = self.per_flight * (count - 1)
        ends = self.low * (count - 1), self.high * (count - 1)
        scale, unit = (100.0, "%") if self.unit == "x" else (1.0, self.unit)
        text = f"{whole * scale:+.3g} {unit} over {count_of(count, 'flight')}"
        return f"{self.controller}: {self.title} {text} ({ends[0] * scale:+.3g} to {ends[1] * scale:+.3g})"

    def record(self) -> dict[str, Any]:
        """Return a JSON line."""
        known = {name: value for name, value in vars(self).items() if name not in ("flights", "values")}
        return known | {"flights": len(self.values), "first": self.flights[0], "last": self.flights[-1]}


@dataclass
class _Flight:
    """What one flight tells. name, start: of the flight; rows: {(controller, title, least): (values, terms)} at full
    seconds; single: {(controller, title, unit, least): value}; least: a key of LEAST."""

    name: str
    start: int
    rows: dict[tuple[str, str, str], tuple[Array, Array]] = field(default_factory=dict)
    single: dict[Key, float] = field(default_factory=dict)


def drifts(data: Path) -> tuple[list[Drift], list[str]]:
    """Return the values of all controllers over the flights of a data set of Parquet files, what drifts first.

    And sentences on what is not told. Raises SetupError.
    """
    flights = sorted(_flights(data), key=lambda flight: flight.start)
    values: dict[Key, list[tuple[str, float]]] = defaultdict(list)
    for key in dict.fromkeys(key for flight in flights for key in flight.rows):
        those = [flight for flight in flights if key in flight.rows]
        for flight, value in zip(those, _beyond([flight.rows[key] for flight in those]), strict=True):
            who, title, unit = key
            values[who, title, "x" if unit == "A" else unit, unit].append((flight.name, value))
    for flight in flights:
        for single, value in flight.single.items():
            values[single].append((flight.name, value))
    _less_others(values)
    told = {key: rows for key, rows in values.items() if len(rows) >= LEAST_FLIGHTS}
    chance = CHANCE / max(1, len(told))
    found = [_drift(key, rows, chance) for key, rows in told.items()]
    few = {key[0] for key in values} - {key[0] for key in told}
    notes = [f"{who}: fewer than {LEAST_FLIGHTS} comparable flights, no trend" for who in sorted(few)]
    if not flights:
        notes.append(f"no flight in {data} has {LEAST_SECONDS:g} s of turning motors")
    return sorted(found, key=lambda one: (not one.is_sure, one.controller, one.title)), notes


def _drift(key: Key, rows: Sequence[tuple[str, float]], chance: float) -> Drift:
    who, title, unit, least = key
    values = np.array([value for _, value in rows])
    numbers = np.arange(len(values), dtype=float)
    each, low, high = slope(numbers, values)
    _, sure_low, sure_high = slope(numbers, values, chance)
    is_sure = (sure_low > 0 or sure_high < 0) and abs(each) * (len(values) - 1) >= LEAST[least]
    return Drift(who, title, unit, [name for name, _ in rows], values, each, low, high, is_sure)


def _less_others(values: dict[Key, list[tuple[str, float]]]) -> None:
    """Take from temperatures and currents what the other controllers have in the same flight: the weather.

    The current that all have in common is a value of its own; a temperature in common is the weather's.
    """
    before = {key: dict(rows) for key, rows in values.items() if key[3] in ("°C", "A")}
    for rows in before.values():  # each beside its own level: the median of levels would jump where two swap places
        level = float(np.median(list(rows.values())))
        rows |= {name: value - level for name, value in rows.items()}
    for key, own in before.items():
        peers = [rows for other, rows in before.items() if other[1:] == key[1:]]
        others = [rows for rows in peers if rows is not own]
        if len(others) > 1:
            usual = {name: [rows[name] for rows in others if name in rows] for name in own}
            values[key] = [(name, value - float(np.median(usual[name]))) for name, value in own.items() if usual[name]]
            if key[3] == "A":
                middle = {name: float(np.median([rows[name] for rows in peers if name in rows])) for name in own}
                values["all controllers", *key[1:]] = list(middle.items())


def _beyond(flights: Sequence[tuple[Array, Array]]) -> list[float]:
    """Return how much higher the values of each flight are than all at equal load.

    flights: ((n) values, (n, k) terms) of each. What the load does is learnt within flights, not between them.
    """
    own = [(values - values.mean(), terms - terms.mean(axis=0)) for values, terms in flights]
    y, x = np.concatenate([values for values, _ in own]), np.concatenate([terms for _, terms in own])
    scale = np.maximum(x.std(axis=0), 1e-12)
    square = (x / scale).T @ (x / scale) + 1e-3 * len(y) * 1e-3 * np.eye(x.shape[1])
    weights = np.linalg.solve(square, (x / scale).T @ y) / scale
    middle = np.median([terms.mean(axis=0) for _, terms in flights], axis=0)
    return [float(values.mean() - (terms.mean(axis=0) - middle) @ weights) for values, terms in flights]


def _flights(data: Path) -> Iterator[_Flight]:
    """Read one flight after the other."""
    folders = {path.name.removeprefix("message="): path for path in sorted(data.glob("message=*")) if path.is_dir()}
    if "flights" not in folders:
        again = f"yapp-tables convert CAPTURES --to parquet --out {data}"
        raise SetupError(f"{data} is no data set of Parquet files: {again}")
    # As the first file has it: metadata, and columns that each flight has.
    tables = {name: ds.dataset(path, pq.read_schema(next(path.rglob("*.parquet")))) for name, path in folders.items()}
    version = (tables["flights"].schema.metadata or {}).get(b"schema", b"").decode()
    if version != str(SCHEMA):
        raise SetupError(f"{data} has version {version} of the tables, not {SCHEMA}: convert the captures again")
    rows = tables["flights"].to_table(columns=["flight_id", "source_file", "start"])
    starts = pc.fill_null(rows["start"].cast(pa.int64()), 0).to_pylist()
    flights = zip(rows["flight_id"].to_pylist(), rows["source_file"].to_pylist(), starts, strict=True)
    messages = [name for name, table in tables.items() if b"every" in (table.schema.metadata or {})]
    for flight, name, start in tqdm(list(flights), unit="flight", disable=None):
        is_its = pc.field("flight_id") == flight
        own = {message: tables[message].to_table(filter=is_its) for message in messages}
        summary = tables["summary"].to_table(filter=is_its).to_pylist()
        found = samples({message: table for message, table in own.items() if len(table)}, start=start)
        if told := _told(found, summary, name, start):
            yield told


def _told(
    found: dict[tuple[str, str], Samples], summary: list[dict[str, Any]], name: str, start: int
) -> _Flight | None:
    flight, loads = _Flight(name, start), {}
    for one in found.values():
        load = Load.of(one)
        if load and np.ptp(one.times) >= LEAST_SECONDS:
            loads[one.controller] = load
            _singles(flight, found, one)
    for one in found.values():
        if one.controller in loads:
            _rows(flight, one, loads[one.controller])
    whose = {ids: one for one in found.values() for ids in one.ids}
    for row in summary:
        lost = max(row.get("missing") or 0, sum(row.get(key) or 0 for key in ("crc_bad", "incomplete")))
        sender = whose.get((row["bus"], row["id"]))
        if sender and sender.controller in loads:
            share = lost / max(row["count"] + lost, 1)
            flight.single[sender.controller, f"lost share of {sender.title}", "", "lost"] = share
    return flight if loads else None


def _rows(flight: _Flight, one: Samples, load: Load) -> None:
    """Keep means of full seconds, of each value at its load, while the motor turns."""
    at = load.at(one.times)
    top = max(float(np.nanquantile(load.speed, 0.98)), 1.0)
    supply, speed = one.supply(), one.speed()
    for name in one.names("value", "A", "%", *DEGREES):
        if name in (speed or ()) or name.endswith("_commanded") or (supply and name == supply[0]):
            continue
        unit = one.unit_of(name)
        values, least = one.columns[name], "°C" if unit in DEGREES else unit
        good = np.isfinite(values) & np.isfinite(at.speed) & np.isfinite(at.volts) & (at.speed > 0.2 * top)
        if good.sum() * one.every < LEAST_SECONDS / 2:
            continue
        if least == "A":
            if (values[good] > 0).mean() < 0.98:
                continue
            good &= values > 0
            # At equal speed the power is the same: a lower supply means a higher current.
            level = at.volts if supply and name == supply[1] else np.ones(len(values))
            values = np.log(np.maximum(values * level, 1e-9))
        # In units that are the same in all flights.
        x = at.speed[good] / 1000
        columns = [x, x**2, x**3]
        if least == "°C":
            columns += list((at.heat[good] / 1e6).T)
        _, second = np.unique(np.floor(one.times[good] / EVERY), return_inverse=True)
        count = np.bincount(second)
        means = [np.bincount(second, column) / count for column in (values[good], *columns)]
        flight.rows[one.controller, one.title_of(name), least] = means[0], np.stack(means[1:], axis=1)


def _singles(flight: _Flight, found: dict[tuple[str, str], Samples], one: Samples) -> None:
    """Keep what is one number a flight: the supply's sag for each ampere, and the lag behind the command."""
    supply = one.supply()
    if supply:
        volts, amperes = (one.columns[name] for name in supply)
        both = np.diff(volts, prepend=np.nan), np.diff(amperes, prepend=np.nan)
        good = np.isfinite(both[0]) & np.isfinite(both[1]) & (one.gaps() < 3 * one.every)
        if good.sum() > 50 and float((both[1][good] ** 2).sum()) > 0:
            sag = -float((both[0][good] * both[1][good]).sum() / (both[1][good] ** 2).sum())
            flight.single[one.controller, "sag of the supply", "V/A", "sag"] = sag
    following = Following.of(found, one)
    if following is not None:
        shapes = range(0, len(SHAPES), 2)
        best = min(shapes, key=lambda shape: following.least(shape, LAGS[::3]))
        sums = np.array([float(following.squares(best, lag).sum()) for lag in LAGS])
        flight.single[one.controller, "response to its command", "s", "lag"] = SHAPES[best] + lowest(LAGS, sums)


def lines(found: Sequence[Drift], notes: Sequence[str]) -> Iterator[str]:
    """Yield the answer as text."""
    sure = [one for one in found if one.is_sure]
    yield from (one.sentence() for one in sure)
    yield from notes
    yield f"{count_of(len(sure), 'drift')} in {count_of(len(found), 'value')} of controllers"


def json_lines(found: Sequence[Drift]) -> Iterator[str]:
    """Yield a JSON line for each value of each controller."""
    return (json.dumps(one.record(), ensure_ascii=False) for one in found)


def page(found: Sequence[Drift], notes: Sequence[str]) -> str:
    """Return a page with one small picture a value, a row a controller."""
    sure = [("worse", one.sentence()) for one in found if one.is_sure]
    titles = list(dict.fromkeys(one.title for one in found))
    rows = [f"<tr><th>controller</th>{''.join(f'<th>{html.escape(title)}</th>' for title in titles)}</tr>"]
    for who in sorted({one.controller for one in found}):
        own = {one.title: _picture(one) for one in found if one.controller == who}
        cells = "".join(f"<td>{own.get(title, '')}</td>" for title in titles)
        rows.append(f"<tr><th>{html.escape(who)}</th>{cells}</tr>")
    lists = [pages.listed(sure or [("", "nothing drifts")]), pages.listed([("pale", note) for note in notes])]
    return pages.page("Trend over flights", [*lists, f"<table>{''.join(rows)}</table>"])


def _picture(one: Drift) -> str:
    middle = (len(one.values) - 1) / 2
    centre = float(np.median(one.values - one.per_flight * (np.arange(len(one.values)) - middle)))
    ends = centre - one.per_flight * middle, centre + one.per_flight * middle
    return pages.dots([float(value) for value in one.values], ends, one.sentence(), one.is_sure)
