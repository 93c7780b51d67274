# SPDX-License-Identifier: GPL-2.0-or-later
"""Messages of controllers as arrays, over one flight or several, and the load at which each sample was taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from .series import Array, numbers
from .sources import natural, split

MEMORY = (10.0, 40.0, 160.0)  # seconds for which a temperature remembers the load
RUNNING = 0.1  # of the usual highest speed: below, a motor stands
APART = 1e6  # seconds between the times of two flights


@dataclass
class Samples:
    """A message of a controller. columns: {name: (n) values}; times: (n) seconds, flights APART; frames: (n).

    about: {name: the metadata of its column, with title, unit, role}; ids: (bus, ID), each that sent it.
    """

    controller: str
    message: str
    title: str
    every: float
    about: dict[str, dict[str, str]]
    times: Array
    frames: Array
    columns: dict[str, Array]
    ids: set[tuple[str | None, int]]
    texts: dict[str, set[str]] = field(default_factory=dict)

    def names(self, role: str, *units: str) -> list[str]:
        """Return the columns of a role, and of these units."""
        return [
            name
            for name, about in self.about.items()
            if about.get("role") == role and (not units or about.get("unit") in units)
        ]

    def supply(self) -> tuple[str, str] | None:
        """Return voltage and current of the supply: in V and A, whose names begin alike."""
        pairs = [(volts, amperes) for volts in self.names("value", "V") for amperes in self.names("value", "A")]
        return next((pair for pair in pairs if len({name.partition("_")[0] for name in pair}) == 1), None)

    def speed(self) -> tuple[str, str] | None:
        """Return what was measured and commanded; of several pairs the last: a speed stands behind a torque."""
        pairs = [(name, name.replace("_measured", "_commanded")) for name in self.names("value")]
        return next((pair for pair in reversed(pairs) if pair[0] != pair[1] and pair[1] in self.columns), None)

    def gaps(self) -> Array:
        """Return the time before each message but the first; NaN between two flights."""
        gaps = np.diff(self.times)
        return np.where(gaps > APART / 2, np.nan, gaps)


def samples(tables: Mapping[str, pa.Table], number: int = 0, start: int = 0) -> dict[tuple[str, str], Samples]:
    """Return the messages of each controller of a flight, by (controller, message).

    tables: {message: rows}; number: of the flight, which moves its times; start: nanoseconds since 1970.
    """
    found: list[Samples] = []
    for message, table in tables.items():
        about = {each.name: _texts(each.metadata) for each in table.schema}
        said = _texts(table.schema.metadata)
        names = [name for name, known in about.items() if known.get("role") in ("value", "flag", "enum", "clock")]
        for name, rows in split(table):
            rows = rows.sort_by("time")
            times = (rows["time"].cast(pa.int64()).to_numpy() - start) / 1e9
            columns = {each: numbers(rows[each]) for each in names}
            every = float(said.get("every") or 0) or (float(np.median(np.diff(times))) if len(times) > 1 else 1.0)
            texts = {each: set(rows[f"{each}_text"].unique().to_pylist()) - {None} for each in names
                     if f"{each}_text" in rows.schema.names}  # fmt: skip
            # A message without a clock of the controller, such as a command, may be for all of a bus: it is its own.
            is_own = any(known.get("role") == "clock" for known in about.values())
            ids = {(rows["bus"][0].as_py(), rows["id"][0].as_py())}
            one = Samples(name if is_own else f"{name} {said.get('title', message)}", message,
                          said.get("title", message), every, about, times + number * APART,
                          rows["frame"].to_numpy(), columns, ids, texts)  # fmt: skip
            found.append(one)
    leads = {(bus, number & 0xF): one for one in reversed(found) if one.speed() for bus, number in one.ids}
    for one in found:
        bus, number = next(iter(one.ids))
        lead = leads.get((bus, number & 0xF))
        if lead and one.names("clock") and one.controller == f"{bus or ''} 0x{number:03x}".strip():
            one.controller = lead.controller
    return {(one.controller, one.message): one for one in sorted(found, key=lambda one: natural(one.controller))}


def _texts(metadata: Mapping[bytes, bytes] | None) -> dict[str, str]:
    return {key.decode(): text.decode() for key, text in (metadata or {}).items()}


def joined(flights: Sequence[Mapping[tuple[str, str], Samples]]) -> dict[tuple[str, str], Samples]:
    """Return the messages of several flights, one behind the other."""
    whole: dict[tuple[str, str], Samples] = {}
    for flight in flights:
        for key, own in flight.items():
            if key in whole:
                one = whole[key]
                one.times = np.concatenate([one.times, own.times])
                one.frames = np.concatenate([one.frames, own.frames])
                one.columns = {name: np.concatenate([one.columns[name], own.columns[name]]) for name in own.columns}
                one.ids |= own.ids
                one.texts = {name: one.texts[name] | own.texts[name] for name in own.texts}
            else:
                whole[key] = own
    return whole


@dataclass
class Load:
    """What the values of a controller depend on. times, speed, volts: (n); heat: (n, len(MEMORY))."""

    times: Array
    speed: Array
    volts: Array
    heat: Array

    @classmethod
    def of(cls, lead: Samples) -> Load | None:
        """Return the load of a controller, from the message that has its speed; None without one."""
        pair, supply = lead.speed(), lead.supply()
        if pair is None:
            return None
        speed = np.abs(lead.columns[pair[0]])
        # What a current takes from its supply at once is no cause of it: the slow part of the supply is.
        volts = _slow(lead.times, lead.columns[supply[0]]) if supply else np.zeros(len(speed))
        heat = _memory(lead.times, np.nan_to_num(speed) ** 2)
        return cls(lead.times, speed, volts, heat)

    def at(self, times: Array) -> Load:
        """Return the load at other times: that of the latest sample, NaN five seconds behind it."""
        at = np.maximum(np.searchsorted(self.times, times, side="right") - 1, 0)
        gone = np.abs(times - self.times[at]) > 5
        return Load(
            times, np.where(gone, np.nan, self.speed[at]), np.where(gone, np.nan, self.volts[at]), self.heat[at]
        )


def _slow(times: Array, values: Array, length: float = 20.0) -> Array:
    """Return the mean of the latest seconds, which begins anew with each flight."""
    found, state = np.empty(len(values)), np.nan
    kept = np.exp(-np.diff(times, prepend=times[:1] - APART) / length)
    for at, value in enumerate(values):
        if not np.isnan(value):
            state = value if np.isnan(state) else value + (state - value) * kept[at]
        found[at] = state
    return found


def _memory(times: Array, power: Array) -> Array:
    """Return the mean of the latest seconds, the older the less, for each length of MEMORY; (n, len(MEMORY))."""
    found = np.zeros((len(times), len(MEMORY)))
    gaps = np.diff(times, prepend=times[:1])
    for column, length in enumerate(MEMORY):
        state = 0.0
        kept = np.exp(-np.clip(gaps, 0, APART) / length)
        for at, value in enumerate(power):
            state = state * kept[at] + value * (1 - kept[at])
            found[at, column] = state
    return found


def terms(before: Load, after: Load, has_heat: bool) -> tuple[Array, Array]:
    """Return what a value depends on: (n, k) for the samples of both, and which of them are at a load of both, (n).

    Speed to the third power; of a temperature what the load was before, too. The supply only sorts into bins: what it
    does within 5 % is less than what a curve through it would make of noise.
    """
    speed, volts = (np.concatenate([getattr(one, name) for one in (before, after)]) for name in ("speed", "volts"))
    is_after = np.repeat([False, True], [len(before.times), len(after.times)])
    bins = load_bins(speed, volts)
    counts = [np.bincount(bins[own & (bins >= 0)], minlength=bins.max(initial=0) + 1) for own in (~is_after, is_after)]
    common = np.append((counts[0] >= 5) & (counts[1] >= 5), [False])
    top = max(float(np.nanmax(speed, initial=1.0)), 1.0)
    x = speed / top
    columns = [x, x**2, x**3]
    if has_heat:
        heat = np.concatenate([before.heat, after.heat]) / top**2
        columns += list(heat.T)
    return np.stack(columns, axis=1), common[bins]


def load_bins(speed: Array, volts: Array, count: int = 12, width: float = 0.05) -> Array:
    """Return the number of each sample's bin, of speed and voltage; -1 where the motor stands or nothing is known."""
    if not np.isfinite(speed).any():
        return np.full(len(speed), -1)
    top = max(float(np.nanquantile(speed, 0.98)), 1e-9)
    step = max(abs(float(np.nanmedian(volts))) * width, 1e-9)
    good = np.isfinite(speed) & np.isfinite(volts) & (speed > RUNNING * top)
    rows = np.clip(np.nan_to_num(speed) / top * count, 0, count + 3).astype(int)
    columns = np.nan_to_num(volts / step)
    columns = np.clip(np.round(columns - np.nanmedian(columns)) + 8, 0, 15).astype(int)
    return np.where(good, rows * 16 + columns, -1)
