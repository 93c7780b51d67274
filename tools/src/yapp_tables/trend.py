# SPDX-License-Identifier: GPL-2.0-or-later
"""Many flights, one trend: of each controller what drifts from flight to flight at equal load. docs/compare.md."""

import html
import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from . import pages
from .changes import Following, Load, comparable, dependent, responses, slope
from .errors import SetupError, count_of, progress
from .series import Array, Samples, samples
from .tables import SCHEMA, is_message, said
from .tshark import Record

LEAST_FLIGHTS, LEAST_SECONDS = 5, 20.0
CHANCE = 0.02  # that one of all slopes is called a drift by chance
# The least drift over all flights that counts: relative, in the unit, in seconds, a share.
LEAST = {"A": 0.02, "°C": 2.0, "%": 3.0, "lag": 0.02, "sag": 0.02, "lost": 0.002}
Key = tuple[str, str, str, str]  # controller, title, unit, key of LEAST
# The values of all controllers, what drifts first, each as a JSON line has it; sentences on what is not told.
Trend = tuple[list[Record], list[str]]


def drifts(data: Path) -> Trend:
    """Return what drifts over the flights of a data set of Parquet files. Raises SetupError.

    per_flight, low, high: the slope and its 95 % interval; is_sure: whether it drifts, judged for all values together.
    """
    rows: dict[Key, list[tuple[str, Array, Array]]] = defaultdict(list)
    values: dict[Key, list[tuple[str, float]]] = defaultdict(list)
    for flight, found, summary in _flights(data):
        loads = {one.controller: load for one in found.values()
                 if (load := Load.of(one)) and np.ptp(one.times) >= LEAST_SECONDS}  # fmt: skip
        own = [one for one in found.values() if one.controller in loads]
        for one in own:
            for key, means, terms in _at_load(one, loads[one.controller]):
                rows[key].append((flight, means, terms))
            for title, unit, least, value in _alone(found, one, summary):
                values[one.controller, title, unit, least].append((flight, value))
    for key, own_rows in rows.items():
        values[key] = _beyond(own_rows)
    _less_others(values)
    told = {key: each for key, each in values.items() if len(each) >= LEAST_FLIGHTS}
    drifting = []
    for (who, title, unit, least), each in told.items():
        numbers, line = np.arange(len(each), dtype=float), np.array([value for _, value in each])
        per_flight, low, high = slope(numbers, line)
        _, sure_low, sure_high = slope(numbers, line, CHANCE / len(told))
        is_sure = not sure_low <= 0 <= sure_high and abs(per_flight) * (len(line) - 1) >= LEAST[least]
        row = {"controller": who, "title": title, "unit": unit, "per_flight": per_flight, "low": low, "high": high}
        row |= {"is_sure": is_sure, "flights": len(line), "first": each[0][0], "last": each[-1][0]}
        drifting.append(row | {"values": line.tolist()})
    few = {key[0] for key in values} - {key[0] for key in told}
    notes = [f"{who}: fewer than {LEAST_FLIGHTS} comparable flights, no trend" for who in sorted(few)]
    if not values:
        notes.append(f"no flight in {data} has {LEAST_SECONDS:g} s of turning motors")
    return sorted(drifting, key=lambda row: (not row["is_sure"], row["controller"], row["title"])), notes


def _flights(data: Path) -> Iterator[tuple[str, dict[tuple[str, str], Samples], list[Record]]]:
    """Yield name, messages and summary of one flight after the other, in the order of time."""
    flights = []
    for path in data.glob("message=flights/*.parquet"):
        row = _read(path)
        version = said(row.schema.metadata).get("schema", "")
        if version != str(SCHEMA):
            raise SetupError(f"{data} has version {version} of the tables, not {SCHEMA}: convert the captures again")
        flights.append((row["start"].cast(pa.int64())[0].as_py() or 0, row["source_file"][0].as_py(), path.name))
    if not flights:
        again = f"yapp-tables convert CAPTURES --to parquet --out {data}"
        raise SetupError(f"{data} is no data set of Parquet files: {again}")
    for start, name, file in progress(sorted(flights), unit=" flights"):
        paths = [folder / file for folder in data.glob("message=*") if (folder / file).is_file()]
        tables = {path.parent.name.removeprefix("message="): _read(path) for path in paths}
        messages = {message: rows for message, rows in tables.items() if is_message(rows) and len(rows)}
        yield name, samples(messages, start=start), _read(data / "message=summary" / file).to_pylist()


def _read(path: Path) -> pa.Table:
    try:
        return pq.read_table(path, partitioning=None)
    except (OSError, pa.ArrowInvalid) as error:
        raise SetupError(f"{path} is damaged: remove it, and convert its capture again ({error})") from error


def _at_load(one: Samples, load: Load) -> Iterator[tuple[Key, Array, Array]]:
    """Yield means of full seconds, of each value and of its load, while the motor turns."""
    at, supply = load.at(one.times), one.supply()
    is_turning = np.isfinite(at.volts) & (at.speed > 0.2 * max(float(np.nanquantile(load.speed, 0.98)), 1.0))
    for name, unit in dependent(one):
        values, good = one.columns[name], is_turning & np.isfinite(one.columns[name])
        if supply and name == supply[1]:
            # At equal speed the power is the same: a lower supply means a higher current.
            values = values * at.volts
        values, good = comparable(values, good, unit)
        if good.sum() * one.every < LEAST_SECONDS / 2:
            continue
        # In units that are the same in all flights.
        columns = np.column_stack([values, at.curve(1000, unit == "°C")])[good]
        second = np.unique(np.floor(one.times[good]), return_inverse=True)[1]
        means = np.stack([np.bincount(second, column) for column in columns.T], axis=1) / np.bincount(second)[:, None]
        yield (one.controller, one.title_of(name), "x" if unit == "A" else unit, unit), means[:, 0], means[:, 1:]


def _alone(found: dict[tuple[str, str], Samples], one: Samples, summary: list[Record]) -> Iterator[tuple[Any, ...]]:
    """Yield values of which a flight has one: title, unit, key of LEAST, value."""
    if (pair := one.supply()) and one.speed():
        # From one message to the next.
        volts, amperes = (np.diff(one.columns[name], prepend=np.nan) for name in pair)
        good = np.isfinite(volts) & np.isfinite(amperes) & (one.gaps() < 3 * one.every)
        square = float((amperes[good] ** 2).sum())
        if good.sum() > 50 and square > 0:
            yield "sag of the supply", "V/A", "sag", -float((volts[good] * amperes[good]).sum()) / square
    if following := Following.of(found, one):
        yield "response to its command", "s", "lag", responses([following])[0][0]
    for row in summary:
        if (row["bus"], row["id"]) in one.ids:
            lost = max(row.get("missing") or 0, sum(row.get(key) or 0 for key in ("crc_bad", "incomplete")))
            yield f"lost share of {one.title}", "", "lost", lost / max(row["count"] + lost, 1)


def _beyond(flights: Sequence[tuple[str, Array, Array]]) -> list[tuple[str, float]]:
    """Return how much higher the values of each flight are than all at equal load.

    flights: name, (n) values and (n, k) terms of each. What the load does is learnt within flights, not between them.
    """
    y = np.concatenate([values - values.mean() for _, values, _ in flights])
    x = np.concatenate([terms - terms.mean(axis=0) for _, _, terms in flights])
    scale = np.maximum(x.std(axis=0), 1e-12)
    square = (x / scale).T @ (x / scale) + 1e-6 * len(y) * np.eye(x.shape[1])
    weights = np.linalg.solve(square, (x / scale).T @ y) / scale
    middle = np.median([terms.mean(axis=0) for *_, terms in flights], axis=0)
    return [(name, float(values.mean() - (terms.mean(axis=0) - middle) @ weights)) for name, values, terms in flights]


def _less_others(values: dict[Key, list[tuple[str, float]]]) -> None:
    """Take from temperatures and currents what the other controllers have in the same flight: the weather.

    The current that all have in common is a value of its own; a temperature in common is the weather's.
    """
    beside: dict[Key, dict[str, float]] = {}
    for key, rows in values.items():
        if key[3] in ("°C", "A"):  # each beside its own level: the median of levels would jump where two swap places
            level = float(np.median([value for _, value in rows]))
            beside[key] = {name: value - level for name, value in rows}
    for key, own in beside.items():
        peers = [rows for other, rows in beside.items() if other[1:] == key[1:]]
        others = [rows for rows in peers if rows is not own]
        if len(others) > 1:
            usual = {name: [rows[name] for rows in others if name in rows] for name in own}
            values[key] = [(name, value - float(np.median(usual[name]))) for name, value in own.items() if usual[name]]
            if key[3] == "A":
                all_ = {name: float(np.median([rows[name] for rows in peers if name in rows])) for name in own}
                values["all controllers", *key[1:]] = list(all_.items())


def lines(found: Trend) -> Iterator[str]:
    """Yield the answer as text."""
    rows, notes = found
    sure = [_sentence(row) for row in rows if row["is_sure"]]
    yield from (*sure, *notes)
    yield f"{count_of(len(sure), 'drift')} in {count_of(len(rows), 'value')} of controllers"


def _sentence(row: Record) -> str:
    scale, unit = (100.0, "%") if row["unit"] == "x" else (1.0, row["unit"])
    whole, low, high = (row[name] * scale * (row["flights"] - 1) for name in ("per_flight", "low", "high"))
    text = f"{whole:+.3g} {unit} over {count_of(row['flights'], 'flight')} ({low:+.3g} to {high:+.3g})"
    return f"{row['controller']}: {row['title']} {text}"


def json_lines(found: Trend) -> Iterator[str]:
    """Yield a JSON line for each value of each controller."""
    return (json.dumps(row, ensure_ascii=False) for row in found[0])


def page(found: Trend) -> str:
    """Return a page with one small picture a value, a row a controller."""
    rows, notes = found
    sure = [("worse", _sentence(row)) for row in rows if row["is_sure"]]
    titles = list(dict.fromkeys(row["title"] for row in rows))
    lines = [f"<tr><th>controller</th>{''.join(f'<th>{html.escape(title)}</th>' for title in titles)}</tr>"]
    for who in sorted({row["controller"] for row in rows}):
        own = {row["title"]: pages.dots(np.array(row["values"]), row["per_flight"], _sentence(row), row["is_sure"])
               for row in rows if row["controller"] == who}  # fmt: skip
        cells = "".join(f"<td>{own.get(title, '')}</td>" for title in titles)
        lines.append(f"<tr><th>{html.escape(who)}</th>{cells}</tr>")
    lists = [pages.listed(sure or [("", "nothing drifts")]), pages.listed([("pale", note) for note in notes])]
    return pages.page("Trend over flights", [*lists, f"<table>{''.join(lines)}</table>"])
