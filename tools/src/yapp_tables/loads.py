# SPDX-License-Identifier: GPL-2.0-or-later
"""What good flights show of values under load: limits over another field, for a time, and means under a condition."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from .series import LATE, Array, numbers

Record = dict[str, Any]
Extreme = tuple[Decimal, Decimal, str]  # the lowest and the highest of a source in a flight, the flight
POINTS = 7  # of a curve
LEAST_SAMPLES = 20  # of a point, of all flights
LEAST_FLIGHTS = 3  # that have it
LEAST_SHARE = 0.02  # of the range of the values, that they scatter at a point
RUNNING = 0.1  # of the highest speed
USUAL = (0.1, 0.98)  # quantiles of a flight without its spin-up and its landing
AFTER = 1.0  # seconds within the points, from which on a value is judged
LONG, SHORT = 10, 4  # periods: a state lasts longer, a step of the command is over
RARE = 0.05  # of the samples: a condition that each flight meets
LEAST_HELD = 12  # samples of each flight


@dataclass
class Samples:
    """What a source sent in a flight: times in seconds, values by field, NaN where there is none."""

    flight: str
    times: Array
    values: dict[str, Array]
    flags: dict[str, Array]


@dataclass
class Finding:
    """What flights show of one source. what: a name that other sources have, too; write: limits to a rule's text."""

    source: str
    what: str
    found: list[Extreme]
    write: Callable[[str, str], str]


def read(folder: Path, flight: str, fields: Record) -> Iterator[tuple[str, str, Samples]]:
    """Yield message, source and samples of the tables of a flight; source: the user's name, or ""."""
    for message, entry in fields["messages"].items():
        path = folder / f"{message}.csv"
        if not path.exists() or not os.path.getsize(path):
            continue
        names = [column["name"] for column in entry["columns"] if column["type"] == "float"]
        flags = [column["name"] for column in entry["columns"] if column["kind"] == "flags"]
        kept = ["time", "bus", "source", "id", *names, *flags]
        types = {"time": pa.string(), "source": pa.string(), "bus": pa.string()}
        table = csv.read_csv(path, convert_options=csv.ConvertOptions(include_columns=kept, column_types=types))
        keys = list(zip(table["bus"].to_pylist(), table["id"].to_pylist(), strict=True))
        for key in dict.fromkeys(keys):
            own = table.filter(pa.array([one == key for one in keys]))
            values = {name: numbers(own[name]) for name in names if own[name].null_count < len(own)}
            for row in entry["differences"]:
                if row["of"] in values and row["less"] in values:
                    values[row["name"]] = values[row["of"]] - values[row["less"]]
            times = np.array([float(Decimal(text) % 10**9) for text in own["time"].to_pylist()])
            words = {name: own[name].to_numpy() for name in flags}
            yield message, own["source"][0].as_py() or "", Samples(flight, times, values, words)


def held(
    samples: Samples, values: Array, length: int, every: float, breaks: Array | None = None
) -> tuple[float, float] | None:
    """Return the highest and the lowest value that lasted for so many periods; None for no values.

    breaks: true where the condition of a rule does not hold.
    """
    good = np.isfinite(values)
    times, kept = samples.times[good], values[good]
    part = _parts(samples, every, breaks)[good]
    ends = np.searchsorted(times, times + length * every - 1e-6)
    windows = [kept[begin : end + 1] for begin, end in enumerate(ends) if end < len(kept) and part[begin] == part[end]]
    if not windows:
        return None
    return float(max(window.min() for window in windows)), float(min(window.max() for window in windows))


def _parts(samples: Samples, every: float, breaks: Array | None) -> Array:
    """Return of each sample how many gaps, and samples without the condition, came up to it."""
    late = np.diff(samples.times, prepend=samples.times[:1]) > LATE * every
    return np.asarray(np.cumsum(late if breaks is None else late | breaks))


def _settled(samples: Samples, every: float, breaks: Array) -> Array:
    """Return where the condition of a rule has held for so long that the rule judges."""
    part = _parts(samples, every, breaks)
    starts = dict(reversed(list(zip(part[~breaks], samples.times[~breaks], strict=True))))
    since = np.array([starts.get(number, np.inf) for number in part])
    return np.asarray(~breaks & (samples.times - since >= AFTER - 1e-6))


class Field:
    """The fields of a message by what they are: of units and names alone."""

    def __init__(self, entry: Record) -> None:
        """entry: of fields.json."""
        units = {column["name"]: column["unit"] for column in entry["columns"] if column["type"] == "float"}
        units = {name: unit for name, unit in units.items() if not name.endswith("_commanded")}
        self.errors = [row["name"] for row in entry["differences"]]
        self.commands = [(row["name"], row["less"], SHORT) for row in entry["differences"]]
        self.speeds = [name for name, unit in units.items() if unit == "RPM"]
        self.torques = [name for name, unit in units.items() if unit == "A" and "torque" in name]
        self.currents = [name for name, unit in units.items() if unit == "A" and name not in self.torques]
        self.powers = [name for name, unit in units.items() if unit == "W"]
        self.warm = [name for name, unit in units.items() if unit in ("°C", "C", "degC")]
        self.pairs = [
            (value, other, length)
            for values, others, length in (
                (self.currents + self.powers + self.torques, self.speeds, LONG),
                (self.warm, self.currents, LONG),
                (self.currents, self.torques, 0),
            )
            for value in values
            for other in others
        ] + self.commands


def findings(fields: Record, flights: Mapping[tuple[str, str], Sequence[Samples]]) -> Iterator[Finding]:
    """Yield what good flights show; flights: samples by source and message."""
    for (source, message), found in flights.items():
        entry = fields["messages"][message]
        every = entry["every"] or float(np.median(np.diff(found[0].times)))
        kinds = Field(entry)
        for value, other, length in kinds.pairs:
            yield from _over(source, message, having(found, value, other), (value, other), (length, every))
        for value, length in ((value, length) for value in kinds.errors for length in (SHORT, LONG)):
            yield _lasting(source, f"{message}.{value}", having(found, value), value, (length, every))
        for value, other in ((value, other) for other in kinds.errors + kinds.torques for value in kinds.currents):
            yield from _conditional(source, message, having(found, value, other), value, other)


def having(found: Sequence[Samples], *names: str) -> list[Samples]:
    """Return the samples that have all these fields; none where they are too few."""
    good = [samples for samples in found if all(name in samples.values for name in names)]
    return good if len(good) >= LEAST_FLIGHTS else []


def _hold(length: int, every: float) -> str:
    return f" for={length * every:.3g}" if length else ""


def _ends(
    found: Sequence[Samples],
    values_of: Callable[[Samples], Array],
    hold: tuple[int, float],
    breaks_of: Callable[[Samples], Array] | None = None,
) -> list[Extreme]:
    """Return what lasted in each flight, on either side: the gate counts a row of values outside, wherever they lie."""
    ends = []
    for samples in found:
        extremes = held(samples, np.abs(values_of(samples)), *hold, breaks_of(samples) if breaks_of else None)
        if extremes:
            top = Decimal(extremes[0])
            ends.append((-top, top, samples.flight))
    return ends


def _lasting(source: str, name: str, found: Sequence[Samples], value: str, hold: tuple[int, float]) -> Finding:
    """Return the limits of what lasts."""
    end = _hold(*hold)

    def write(low: str, high: str) -> str:
        return f"{name}={low}..{high}{end}"

    return Finding(source, name + end, _ends(found, lambda samples: samples.values[value], hold), write)


def _over(
    source: str, message: str, found: Sequence[Samples], names: tuple[str, str], hold: tuple[int, float]
) -> Iterator[Finding]:
    """Yield limits over another field.

    At each point: a centre, the median of the flights' medians; how far values scatter about it; and so many of these
    as flights, as wholes, lay away for as long as the rule asks for.
    """
    value, other = names
    pairs = [_running(samples, value, other) for samples in found]
    if not sum(len(x) for x, _ in pairs):
        return
    points, centres, scatter = _curve(pairs)
    if len(points) < 2:
        return

    low_end, high_end = float(f"{points[0]:.4g}"), float(f"{points[-1]:.4g}")
    suffix = f" when={other}={low_end:.4g}..{high_end:.4g} after={AFTER:g}" if hold[0] else ""

    def breaks(samples: Samples) -> Array:
        x = samples.values[other]
        return np.asarray((x < low_end) | (x > high_end))

    def away(samples: Samples) -> Array:
        x, y = samples.values[other], samples.values[value]
        judged = _settled(samples, hold[1], breaks(samples)) if hold[0] else ~breaks(samples)
        return np.where(judged, (y - np.interp(x, points, centres)) / np.interp(x, points, scatter), np.nan)

    def write(low: str, high: str) -> str:
        limits = ";".join(
            f"{x:.4g}:{centre + float(low) * size:.4g}..{centre + float(high) * size:.4g}"
            for x, centre, size in zip(points, centres, scatter, strict=True)
        )
        return f"{message}.{value}.over({other})={limits}{suffix}{_hold(*hold)}"

    yield Finding(source, f"{message}.{value}.over({other})", _ends(found, away, hold, breaks), write)


def _running(samples: Samples, value: str, other: str) -> tuple[Array, Array]:
    x, y = samples.values[other], samples.values[value]
    good = np.isfinite(x) & np.isfinite(y)
    good[good] = np.abs(x[good]) > RUNNING * np.max(np.abs(x[good]), initial=0.0)
    return x[good], y[good]


def _curve(pairs: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, Array]:
    """Return points, centres and scatters of values over another field: where enough flights have enough samples."""
    every_x, every_y = (np.concatenate(list(each)) for each in zip(*pairs, strict=True))
    low, high = np.quantile(every_x, USUAL)
    grid = np.linspace(low, high, POINTS)
    width = (grid[1] - grid[0]) / 2
    floor = LEAST_SHARE * float(np.quantile(every_y, 0.98) - np.quantile(every_y, 0.02))
    rows = []
    for at in grid if min(width, floor) > 0 else ():
        own = [y[np.abs(x - at) <= width] for x, y in pairs]
        near = every_x[np.abs(every_x - at) <= width]
        medians = [float(np.median(y)) for y in own if len(y)]
        y = np.concatenate(own)
        if len(medians) < LEAST_FLIGHTS or len(y) < LEAST_SAMPLES:
            continue
        centre = float(np.median(medians))
        rows.append((float(np.median(near)), centre, max(1.4826 * float(np.median(np.abs(y - centre))), floor)))
    return tuple(np.array(each) for each in zip(*rows, strict=True)) if rows else (np.array([]),) * 3  # type: ignore[return-value]


def _conditional(source: str, message: str, found: Sequence[Samples], value: str, other: str) -> Iterator[Finding]:
    """Yield the mean at the lowest and at the highest values of another field, if each flight has some of these."""
    every = np.concatenate([samples.values[other] for samples in found]) if found else np.array([])
    for quantile, sign in ((1 - RARE, 1), (RARE, -1)) if np.isfinite(every).any() else ():
        edge = float(f"{np.nanquantile(every, quantile):.2g}")
        ends = []
        for samples in found:
            x, y = samples.values[other], samples.values[value]
            good = (sign * x >= sign * edge) & np.isfinite(y)
            if good.sum() >= LEAST_HELD:
                mean = Decimal(float(y[good].mean()))
                ends.append((mean, mean, samples.flight))
        if sign * edge > 0 and len(ends) == len(found):
            name, when = f"{message}.{value}.mean", f"{other}={edge:g}.." if sign > 0 else f"{other}=..{edge:g}"

            def write(low: str, high: str, name: str = name, when: str = when) -> str:
                return f"{name}={low}..{high} when={when}"

            yield Finding(source, f"{name} {other} {sign}", ends, write)


def by_source(found: Sequence[tuple[str, str, Samples]]) -> dict[tuple[str, str], list[Samples]]:
    """Return the samples of flights by source and message; without a source where one of a message has no name."""
    nameless = {message for message, source, _ in found if not source}
    flights = defaultdict(list)
    for message, source, samples in found:
        flights["" if message in nameless else source, message].append(samples)
    return flights


def noises(
    fields: Record, flights: Mapping[tuple[str, str], Sequence[Samples]]
) -> dict[tuple[str, str], list[Extreme]]:
    """Return of each flight how far values lie from the mean of their neighbours, as the rule `noise` has it."""
    found = defaultdict(list)
    for (source, message), samples in flights.items():
        warm = Field(fields["messages"][message]).warm
        for one in samples:
            for name, values in one.values.items():
                good = values[np.isfinite(values)]
                if len(good) > 2 and name not in warm:
                    noise = Decimal(float(np.mean(np.abs(good[1:-1] - (good[:-2] + good[2:]) / 2))))
                    found[source, f"{message}.{name}.noise"].append((noise, noise, one.flight))
    return {key: rows for key, rows in found.items() if max(high for _, high, _ in rows)}


def constant_flags(fields: Record, flights: Mapping[tuple[str, str], Sequence[Samples]]) -> Iterator[tuple[str, str]]:
    """Yield source and rule of flags that never changed in any flight."""
    for (source, message), samples in flights.items():
        for column in fields["messages"][message]["columns"]:
            seen = {float(one) for each in samples for one in np.unique(each.flags.get(column["name"], []))}
            if len(seen) == 1:
                text = f"{seen.pop():.0f}"
                yield source, f"{message}.{column['name']}={text}..{text}"
