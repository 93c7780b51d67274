# SPDX-License-Identifier: GPL-2.0-or-later
"""Which controller is different from the others of its message: the rules that docs/tables.md states.

An innocent one must not be accused. So the others have to agree among themselves, nobody of them may be where the odd
one is, and nobody is compared while a Command is disabled or lost, or the controller itself reboots or is silent.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from .series import DEGREES, Array, Samples
from .words import minute

Record = dict[str, Any]
Found = Sequence[Samples]  # one message of all sources
Windows = Sequence[tuple[float, float]]  # begin and end, in seconds since the report's start
HOT, COLD, SECONDS = 10.0, 20.0, 20  # a temperature above or below the others, for so long
FOLLOWS, SHARE = 2.0, 0.002  # times worse than the others, and of the largest command
LOAD, SPREADS = 1.25, 4.0  # times the others' level, and further away than they lie apart
SURGE, STEPS = 1.8, 2  # times the others' value at the same moment, for so many messages
APART = 0.1  # and by this share of the largest value of a flight
ALIKE = 0.03  # of its speed: peers turn as fast
AGREE = 2 / 3  # of the others have to be alike
FLYING = 0.3  # of the usual highest speed
DIP = 0.9  # of the usual voltage
AROUND = 10.0  # seconds before and after a fault


def flying(found: Found) -> list[tuple[float, float]]:
    """Return the stretches of flight: most controllers turn faster than FLYING of their usual highest speed."""
    pair = found[0].speed()
    if pair is None:
        return []
    grid = np.abs(_by_second(found, [one.columns[pair[0]] for one in found]))
    with warnings.catch_warnings(action="ignore"):
        speed = np.nanmedian(grid, axis=0)
    if not np.isfinite(speed).any():
        return []
    is_flying = speed > FLYING * np.nanquantile(speed, 0.95)
    for begin, end in _runs(~is_flying, 1):  # a short break is none
        if begin > 0 and end < len(speed) and end - begin < 5:
            is_flying[begin:end] = True
    return sorted((float(begin), float(end)) for begin, end in _runs(is_flying, 5))


def calm_samples(one: Samples, flight: Windows, excused: Windows) -> Array:
    """Return which samples can be compared: in flight, if one is known, and not excused; (n) bool."""
    use = np.full(len(one.times), not flight)
    for begin, end in flight:
        use |= (one.times >= begin) & (one.times < end)
    for begin, end in excused:
        use &= (one.times < begin) | (one.times > end)
    return use


def differing(found: Found, alarms: set[str]) -> list[Record]:
    """Return {source, kind, field, text, at, end, ...} of each controller that is different.

    alarms: flags that are faults.
    """
    said: list[Record] = []
    if len(found) < 2:
        return said
    lead, peers = found[0], _peers(found)
    supply, speed = lead.supply() or ("", ""), lead.speed()
    for name in lead.names("value"):
        unit, rows = lead.unit_of(name), list[Record]()
        values = [np.where(one.calm, one.columns[name], np.nan) for one in found]
        command = name.replace("_measured", "_commanded")
        if unit in DEGREES:
            rows += _temperature(found, values)
        elif command != name and command in lead.columns:
            rows += _following(values, [_commands(one, command, alarms) for one in found])
        elif unit in ("A", "V", "W") and not name.endswith("_error"):
            rows += _level(found, values, peers)
        if name == supply[1]:
            rows += _surges(found, values)
        about = {"field": name, "title": lead.title_of(name), "unit": unit, "is_supply": name in supply}
        for row in rows:
            said.append({"source": found[row.pop("number")].name, "at": 0.0, "end": None} | about | row)
    if speed:
        followed = {row["source"] for row in said if row["kind"] == "follows" and row["field"] == speed[0]}
        said = [row for row in said if row["kind"] != "follows" or row["source"] not in followed
                or row["field"] == speed[0]]  # fmt: skip
    return said


def _temperature(found: Found, values: list[Array]) -> list[Record]:
    """Find who is HOT away from the others for SECONDS: the longest stretch."""
    grid, said = _by_second(found, values), []
    for number, own in enumerate(grid):
        middle, is_odd = _beside(grid, number, HOT, 1)
        for sign, word in ((1, "hotter"), (-1, "cooler")):
            if sign < 0 and len(found) == 2:  # of two, the hot one is said
                continue
            away = sign * (own - middle)
            for begin, end in _runs((away > (HOT if sign > 0 else COLD)) & is_odd)[:1]:
                last = float(np.nanmedian(own[max(begin, end - 10) : end]))
                apart = float(np.nanmedian(away[max(begin, end - 10) : end]))
                minutes = np.arange(begin, end)[-60:] / 60
                good = np.isfinite(own[begin:end][-60:])
                slope = float(np.polyfit(minutes[good], own[begin:end][-60:][good], 1)[0]) if good.sum() > 9 else 0.0
                text = f"{last:.0f} °C at {minute(end)}, {apart:.0f} °C {word} than the others, from {minute(begin)} on"
                more = {"at": float(begin), "end": float(end), "value": last, "away": sign * apart, "slope": slope}
                said.append({"number": number, "kind": "temperature", "text": text} | more)
    return said


def _runs(holds: Array, least: int = SECONDS) -> list[tuple[int, int]]:
    """Return begin and end of each stretch of so many or more, the longest first."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    found = [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
    return sorted((run for run in found if run[1] - run[0] >= least), key=lambda run: run[0] - run[1])


def _commands(one: Samples, name: str, alarms: set[str]) -> Array:
    """Return what a controller was told; NaN around its faults."""
    command = one.columns[name]
    for flag in alarms:
        at = one.times[one.columns[flag] > 0]
        after = np.searchsorted(at, one.times, side="right")
        since = one.times - np.concatenate([[-np.inf], at])[after]
        until = np.concatenate([at, [np.inf]])[after] - one.times
        command = np.where((since < AROUND) | (until < AROUND), np.nan, command)
    return command


def _following(values: list[Array], commands: list[Array]) -> list[Record]:
    """Compare the mean distance from the command; its largest 2 % do not count: a fault is said elsewhere."""
    errors = np.full(len(values), np.nan)
    for number, (measured, command) in enumerate(zip(values, commands, strict=True)):
        away = np.sort(np.abs(measured - command)[np.isfinite(measured - command)])
        if len(away) > 50:
            errors[number] = away[: int(len(away) * 0.98)].mean()
    least = SHARE * max((np.nanmax(np.abs(command), initial=0.0) for command in commands), default=0.0)
    said = []
    for number, error in enumerate(errors):
        others = np.delete(errors, number)
        others = others[np.isfinite(others)]
        usual = float(np.median(others) if len(others) > 2 else others.max(initial=0.0))
        if error > max(FOLLOWS * usual, least) and usual > 0:
            text = f"follows its command {error / usual:.1f} times worse than the others"
            said.append({"number": number, "kind": "follows", "text": text})
    return said


def _peers(found: Found) -> list[list[int]]:
    """Return the others that turned as fast as each source; all others where these are fewer than three."""
    levels, pair = [np.nan] * len(found), found[0].speed()
    if pair:
        levels = [_median(np.abs(one.columns[pair[0]][one.calm])) for one in found]
    peers = []
    for number, level in enumerate(levels):
        others = [other for other in range(len(levels)) if other != number]
        alike = [other for other in others if abs(levels[other] - level) <= ALIKE * level]
        peers.append(alike if len(alike) > 2 else others)
    return peers


def _median(values: Array) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan


def _level(found: Found, values: list[Array], peers: list[list[int]]) -> list[Record]:
    """Compare the median of the flight; it needs three peers that agree."""
    levels = np.array([_median(each) for each in values])
    said: list[Record] = []
    for number, level in enumerate(levels if len(found) > 3 else ()):
        others = levels[peers[number]]
        others = others[np.isfinite(others)]
        middle = float(np.median(others)) if len(others) > 2 else np.nan
        near = np.sort(np.abs(others - middle))[: int(np.ceil(AGREE * len(others)))]
        away = abs(level - middle)
        if away > max((LOAD - 1) * abs(middle), SPREADS * 2 * near.max(initial=0.0), 1.0):
            with warnings.catch_warnings(action="ignore"):
                grid = _by_second(found, values)
                far = np.abs(grid[number] - np.nanmedian(grid[peers[number]], axis=0)) > away / 3
            share, text = float(far[np.isfinite(grid[number])].mean()), "higher" if level > middle else "lower"
            more = {"value": float(level), "beside": middle, "share": share}
            said.append({"number": number, "kind": "level", "text": text} | more)
    return said


def _surges(found: Found, values: list[Array]) -> list[Record]:
    """Find who had a multiple of what the others had at the same moment."""
    if len(found) < 3:
        return []
    every = max(one.every for one in found)
    size = int(max(one.times[-1] for one in found) / every) + 2
    grid = np.full((len(found), size), np.nan)
    for row, one, own in zip(grid, found, values, strict=True):
        row[np.maximum(0, np.rint(one.times / every)).astype(int)] = own
    # A message that comes a bit late leaves a step without a value: the one before stands there.
    grid[:, 1:] = np.where(np.isnan(grid[:, 1:]), grid[:, :-1], grid[:, 1:])
    largest = np.nanmax(np.abs(grid), initial=0.0)
    said = []
    for number, own in enumerate(grid):
        middle, is_odd = _beside(grid, number, APART * largest, 0)
        away = own - middle
        usual = float(np.nanquantile(np.abs(away), 0.95)) if np.isfinite(away).any() else 0.0
        far = is_odd & (own > SURGE * np.abs(middle)) & (away > max(APART * largest, 2 * usual))
        for begin, end in _runs(far, STEPS)[:1]:
            times = float(np.median(own[begin:end] / np.maximum(middle[begin:end], 1e-9)))
            more = {"at": begin * every, "end": end * every, "times": times, "value": float(np.nanmax(own[begin:end]))}
            said.append({"number": number, "kind": "surge", "text": f"{times:.1f} times the others'"} | more)
    return said


def sagging(found: Found, flight: Windows) -> list[Record]:
    """Find when the supply of most controllers was below DIP of what it was a minute around."""
    pair = found[0].supply()
    if pair is None:
        return []
    with warnings.catch_warnings(action="ignore"):
        volts = np.nanmedian(_by_second(found, [one.columns[pair[0]] for one in found]), axis=0)
        second = np.arange(len(volts))
        for begin, end in [(0, flight[0][0]), (flight[-1][1], np.inf)] if flight else []:
            volts[(second >= begin) & (second < end)] = np.nan
        usual = np.array([np.nanmedian(volts[max(0, at - 60) : at + 60]) for at in second])
    about = {"source": "Battery", "kind": "sag", "field": pair[0], "title": found[0].title_of(pair[0]), "unit": "V"}
    said = []
    for begin, end in sorted(_runs(volts < DIP * usual, 2)):
        low = float(np.nanmin(volts[begin:end]))
        text = f"{usual[begin]:.1f} to {low:.1f} V, {minute(begin)} to {minute(end)}, all controllers"
        said.append(about | {"text": text, "at": float(begin), "end": float(end), "value": low, "is_supply": True})
    return said


def _beside(grid: Array, number: int, near: float, company: int) -> tuple[Array, Array]:
    """Return what the others have at each moment, and whether a controller that is far from it would be odd: (n), (n).

    The others agree where AGREE of them lie within `near` of their median, all of three or fewer. Of more than six
    so many others (company) may be where it is.
    """
    others = np.delete(grid, number, axis=0)
    known = np.isfinite(others).sum(axis=0)
    with warnings.catch_warnings(action="ignore"):
        middle = np.nanmedian(others, axis=0)
        is_alike = (np.abs(others - middle) <= near).sum(axis=0)
        beside = (np.abs(others - grid[number]) < np.abs(grid[number] - middle) / 2).sum(axis=0)
    needed = np.where(known > 3, np.ceil(AGREE * known), known)
    return middle, (is_alike >= needed) & (known >= min(2, len(others))) & (beside <= company * (known > 5))


def _by_second(found: Found, values: list[Array]) -> Array:
    """Return the mean of each source and second, the one before where there is none; NaN after five seconds."""
    length = int(max(one.times[-1] for one in found)) + 1
    grid = np.full((len(found), length), np.nan)
    for row, one, each in zip(grid, found, values, strict=True):
        good = np.isfinite(each) & (one.times >= 0)
        at = one.times[good].astype(int)
        count = np.bincount(at, minlength=length)
        total = np.bincount(at, each[good], minlength=length)
        last = np.maximum.accumulate(np.where(count > 0, np.arange(length), -1))
        known = (last >= 0) & (np.arange(length) - last <= 5)
        row[known] = (total / np.maximum(count, 1))[last[known]]
    return grid
