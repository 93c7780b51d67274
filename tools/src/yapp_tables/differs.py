# SPDX-License-Identifier: GPL-2.0-or-later
"""Which controller is different from the others of its message, or beyond its limits: as docs/tables.md states.

An innocent one must not be accused. So the others have to agree among themselves, nobody of them may be where the odd
one is, and nobody is compared while a Command is disabled or lost, or the controller itself reboots or is silent.
"""

import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from .series import DEGREES, Array, Samples
from .tshark import Record

Found = Sequence[Samples]  # one message of all sources
Windows = Sequence[tuple[float, float]]  # begin and end, in seconds since the report's start
HOT, COLD, SECONDS = 10.0, 20.0, 20  # a temperature above or below the others, for so long
LOAD, SPREADS = 0.25, 8.0  # a share of the others' level, and times as far as they lie apart
SURGE, STEPS = 1.8, 2  # times the others' value at the same moment, for so many messages
APART = 0.1  # and by this share of the largest value of a flight
ALIKE = 0.03  # of its speed: peers turn as fast
AGREE = 2 / 3  # of the others have to be alike
FLYING = 0.3  # of the usual highest speed
DIP = 0.9  # of the usual voltage


def flying(found: Found) -> list[tuple[float, float]]:
    """Return the stretches of flight: most controllers turn faster than FLYING of their usual highest speed."""
    pair = found[0].speed()
    speed = middle_of(np.abs(_by_second(found, [one.columns[pair[0]] for one in found]))) if pair else np.zeros(0)
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


def differing(found: Found) -> list[Record]:
    """Return {source, kind, field, title, unit, at, end, ...} of each controller that is different."""
    rows: list[Record] = []
    lead, supply = found[0], found[0].supply() or ("", "")
    followed = {name.replace("_commanded", "_measured") for name in lead.columns if name.endswith("_commanded")}
    for name in lead.names("value") if len(found) > 1 else ():
        unit = lead.unit_of(name)
        values = [np.where(one.calm, one.columns[name], np.nan) for one in found]
        own: list[Record] = []
        if unit in DEGREES:
            own += _temperature(found, values)
        elif unit in ("A", "V", "W") and name not in followed and not name.endswith("_error"):
            own += _level(found, values)
        if name == supply[1]:
            own += _surges(found, values)
        about = {"field": name, "title": lead.title_of(name), "unit": unit, "is_supply": name in supply}
        rows += [{"source": found[row.pop("number")].name, "at": 0.0, "end": None} | about | row for row in own]
    return rows


def _temperature(found: Found, values: list[Array]) -> Iterator[Record]:
    """Find who is HOT above, or COLD below the others for SECONDS: the longest stretch. Of two, the hot one is said."""
    grid = _by_second(found, values)
    for number, own in enumerate(grid):
        middle, is_odd = _beside(grid, number, HOT, 1)
        for sign, least in ((1, HOT), (-1, COLD))[: len(found) - 1]:
            away = sign * (own - middle)
            for begin, end in _runs((away > least) & is_odd)[:1]:
                last, minutes = slice(max(begin, end - 10), end), np.arange(begin, end)[-60:] / 60
                good = np.isfinite(own[begin:end][-60:])
                slope = float(np.polyfit(minutes[good], own[begin:end][-60:][good], 1)[0]) if good.sum() > 9 else 0.0
                yield {
                    "number": number, "kind": "temperature", "at": float(begin), "end": float(end), "slope": slope,
                    "value": float(np.nanmedian(own[last])), "away": sign * float(np.nanmedian(away[last])),
                }  # fmt: skip


def _level(found: Found, values: list[Array]) -> Iterator[Record]:
    """Find whose level is odd in the whole flight, else in its later half, else in its last quarter, and since when."""
    times = [one.times[np.isfinite(each)] for one, each in zip(found, values, strict=True)]
    whole = np.concatenate([[0.0], *times])
    begin, end = whole[1:].min(initial=np.inf), whole.max()
    grid, told = _by_second(found, values), set()
    for part in (1.0, 0.5, 0.25):
        since = end - part * (end - begin)
        later = [np.where(one.times >= since, each, np.nan) for one, each in zip(found, values, strict=True)]
        for row, peers in _levels(later, found):
            number, own = row["number"], grid[row["number"]]
            far = np.abs(own - middle_of(grid[peers])) > abs(row["value"] - row["beside"]) / 3
            if number not in told and far.any():
                told.add(number)
                at, until = _runs(far, 1)[0]
                is_once = until - at > 0.8 * far.sum()
                span = {"at": float(at), "end": float(until)} if is_once else {}
                yield row | {"share": float(far[np.isfinite(own)].mean())} | span


def _levels(values: list[Array], found: Found) -> Iterator[tuple[Record, Array]]:
    """Compare medians with those of controllers that turned as fast; it needs three that agree: what is odd, its peers.

    If fewer turned as fast, it is odd beside them and beside all; if nobody did, only against what its speed explains.
    """
    levels, pair = _medians(values), found[0].speed()
    turning = [np.abs(one.columns[pair[0]]) if pair else each for one, each in zip(found, values, strict=True)]
    speeds = _medians([np.where(np.isfinite(each), own, np.nan) for own, each in zip(turning, values, strict=True)])
    for number, level in enumerate(levels if len(found) > 3 else ()):
        others = np.arange(len(levels)) != number
        alike = others & (np.abs(speeds - speeds[number]) <= ALIKE * speeds[number])
        peers = alike if pair and alike.sum() > 2 else others
        known = levels[peers & np.isfinite(levels)]
        middle = float(np.median(known)) if len(known) > 2 else np.nan
        near = np.sort(np.abs(known - middle))[: int(np.ceil(AGREE * len(known)))]
        same = levels[alike & np.isfinite(levels)] if pair else known
        beside = float(np.median(same)) if len(same) else middle
        away = min(abs(level - middle), abs(level - beside))
        is_faster = speeds[number] > np.nanmedian(speeds[others])
        if not len(same) and is_faster == (level > middle):
            continue
        if away > max(LOAD * abs(middle), SPREADS * near.max(initial=0.0), 1.0):
            yield {"number": number, "kind": "level", "value": float(level), "beside": beside}, peers


def _medians(values: list[Array]) -> Array:
    return np.array([np.nanmedian(each) if np.isfinite(each).any() else np.nan for each in values])


def _surges(found: Found, values: list[Array]) -> Iterator[Record]:
    """Find who had a multiple of what the others had at the same moment."""
    every = max(one.every for one in found)
    # A message that comes a bit late leaves a step without a value: the one before stands there.
    grid = _by_second(found, values, every, 1)
    least = APART * np.nanmax(np.abs(grid), initial=0.0)
    for number, own in enumerate(grid if len(found) > 2 else ()):
        middle, is_odd = _beside(grid, number, least, 0)
        away = own - middle
        usual = float(np.nanquantile(np.abs(away), 0.95)) if np.isfinite(away).any() else 0.0
        far = is_odd & (own > SURGE * np.abs(middle)) & (away > max(least, 2 * usual))
        for begin, end in _runs(far, STEPS)[:1]:
            times = float(np.median(own[begin:end] / np.maximum(middle[begin:end], 1e-9)))
            came = found[number].times  # of the messages, not of the steps
            at, last = came[np.searchsorted(came, begin * every)], came[np.searchsorted(came, end * every) - 1]
            span = {"at": float(at), "end": float(last + every)}
            yield span | {"number": number, "kind": "surge", "times": times, "value": float(np.nanmax(own[begin:end]))}


def sagging(found: Found, flight: Windows) -> Iterator[Record]:
    """Find when the supply of most controllers was below DIP of what it was a minute around."""
    if pair := found[0].supply():
        volts = middle_of(_by_second(found, [one.columns[pair[0]] for one in found]))
        second = np.arange(len(volts))
        if flight:
            volts[(second < flight[0][0]) | (second >= flight[-1][1])] = np.nan
        usual = _medians([volts[max(0, at - 60) : at + 60] for at in second])
        about = {"source": "Battery", "kind": "sag", "field": pair[0], "title": found[0].title_of(pair[0]), "unit": "V"}
        for begin, end in sorted(_runs(volts < DIP * usual, 2)):
            span = {"at": float(begin), "end": float(end), "value": float(np.nanmin(volts[begin:end]))}
            yield about | span | {"usual": float(usual[begin]), "is_supply": True, "more": ""}


def _runs(holds: Array, least: int = SECONDS) -> list[tuple[int, int]]:
    """Return begin and end of each stretch of so many or more, the longest first."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    found = [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
    return sorted((run for run in found if run[1] - run[0] >= least), key=lambda run: run[0] - run[1])


def _beside(grid: Array, number: int, near: float, company: int) -> tuple[Array, Array]:
    """Return what the others have at each moment, and whether a controller that is far from it would be odd: (n), (n).

    The others agree where AGREE of them lie within `near` of their median, all of three or fewer. Of more than six
    so many others (company) may be where it is.
    """
    others = np.delete(grid, number, axis=0)
    known, middle = np.isfinite(others).sum(axis=0), middle_of(others)
    is_alike = (np.abs(others - middle) <= near).sum(axis=0)
    beside = (np.abs(others - grid[number]) < np.abs(grid[number] - middle) / 2).sum(axis=0)
    needed = np.where(known > 3, np.ceil(AGREE * known), known)
    return middle, (is_alike >= needed) & (known >= min(2, len(others))) & (beside <= company * (known > 5))


def middle_of(grid: Array) -> Array:
    """Return the median at each moment; NaN where there is no value."""
    with warnings.catch_warnings(action="ignore"):
        return np.asarray(np.nanmedian(grid, axis=0))


def _by_second(found: Found, values: list[Array], step: float = 1.0, hold: int = 5) -> Array:
    """Return the mean of each source and second, the one before where there is none; NaN after five seconds.

    step: another length than a second; hold: so many steps a value stands.
    """
    length = int(max(one.times[-1] for one in found) / step) + 1
    grid = np.full((len(found), length), np.nan)
    for row, one, each in zip(grid, found, values, strict=True):
        good = np.isfinite(each) & (one.times >= 0)
        at = (one.times[good] / step).astype(int)
        count = np.bincount(at, minlength=length)
        last = np.maximum.accumulate(np.where(count > 0, np.arange(length), -1))
        known = (last >= 0) & (np.arange(length) - last <= hold)
        row[known] = (np.bincount(at, each[good], minlength=length) / np.maximum(count, 1))[last[known]]
    return grid


# ---- limits, out of a file of rules for -z yapp,check or a default set

RANGE = re.compile(r"(\w+)\.(\w+)(?:\.value)?=(-?[\d.]*?)\.\.(-?[\d.]*)")


class Limits:
    """The rules that are ranges, `motor.dc_voltage=40..55`; of a source where they stand below `source=NAME`."""

    def __init__(self, path: Path | None = None) -> None:
        """path: a file of rules, None for the default set. Raises OSError."""
        self.is_default = path is None
        self.ranges: dict[tuple[str, str, str], tuple[float, float]] = {}
        rules, source = path or Path(__file__).with_name("default.rules"), ""
        lines = rules.read_text(encoding="utf-8", errors="replace").splitlines()
        for text in (line.partition("#")[0].strip() for line in lines):
            if text.startswith("source="):
                source = text.removeprefix("source=")
            elif found := RANGE.fullmatch(text):
                message, field, low, high = found.groups()
                self.ranges[source, message, field] = float(low or "-inf"), float(high or "inf")

    def of(self, one: Samples, field: str) -> tuple[float, float]:
        """Return the lowest and the highest value that a source may have; infinite where no rule says so."""
        both = (self.ranges.get((name, one.message, field), (-np.inf, np.inf)) for name in ("", one.name))
        lows, highs = zip(*both, strict=True)
        return max(lows), min(highs)


def beyond(one: Samples, name: str, limits: tuple[float, float]) -> list[Record]:
    """Say when a value was outside its limits, how far and how long; or when it would be, by its last minute."""
    found, values = [], one.columns[name]
    for word, limit, sign in zip(("below", "above"), limits, (-1, 1), strict=True):
        out = sign * values > sign * limit
        if out.any():
            span = {"at": float(one.times[out][0]), "end": float(one.times[out][-1] + one.every)}
            how = {"kind": "limit", "limit": limit, "word": word, "seconds": float(out.sum() * one.every)}
            found.append(span | how | {"value": sign * float(np.nanmax(sign * values))})
    use = np.isfinite(values) & one.flying  # only in flight it goes on to rise
    use &= one.times > one.times[use].max(initial=-np.inf) - 60
    if not found and np.isfinite(limits[1]) and use.sum() > 2 and np.ptp(one.times[use]) >= 30:
        begin, end = map(float, one.times[use][[0, -1]])
        rate, value = map(float, np.polyfit(one.times[use] - end, values[use], 1))
        if rate >= 1 / 60 and 0 < (left := (limits[1] - value) / rate) < 600:
            found.append({"kind": "left", "at": begin, "end": end, "limit": limits[1], "seconds": left, "value": value})
    about = {"source": one.name, "field": name, "title": one.title_of(name), "unit": one.unit_of(name)}
    return [about | row | {"is_supply": name in (one.supply() or ())} for row in found]
