# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits learnt from good flights: rules for -z yapp,check, which then judges whether a flight is like these."""

import math
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from . import __version__
from .errors import CaptureError, count_of
from .flight import Flight
from .scratch import scratch
from .series import DEGREES, LATE, Array, Samples, samples
from .tables import differences
from .tshark import Export, Record, Tshark

MARGIN = 0.1  # of the range that the flights cover
# A range that is narrow for its value counts as this share of the value: what never changed may do so a little.
LEAST_RANGE = 0.25
NOISE = 0.1  # of the margin, beyond an extreme of 0
# What differs from flight to flight, such as speed and battery, is the same for all controllers: their ratio keeps to
# this share of the room.
ROOM_OF_RATIO = 0.5
COMPARED = ("A", "RPM", "V", *DEGREES)  # units of the fields that have a ratio
UPPER = ("gap", "noise")  # measures with an upper limit only
LEAST_TRIED = 4  # flights: fewer say nothing of one that has no part
ROOMS = (1.0, 1.5, 2.5)  # of a limit, until each flight keeps it that has no part in it
LEAST_LOAD = 0.1  # of the largest current, that a mean is where a ratio tells something
OF_CHECK = "damaged or lost messages may hide faults"  # what check says, and the rules count
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
HEAD = """\
# Learnt by yapp-tables {version} from {flights}.
# A # takes a rule out; edit the numbers as you like. Behind each: the extreme of the good flights, and whose it is.
# The first rules are those of check alone. Reserved values are in no range.
"""
Extreme = tuple[float, float, str]  # the lowest and the highest of a source in a flight, the flight
Write = Callable[[str, str], str]  # limits below and above to the text of a rule
Found = Sequence[tuple[str, Samples]]  # the samples of one source in each flight, with the flight's name


@dataclass
class Rule:
    """A rule. source: the user's name of the one it is about, "" for all; lost: which good flight does not keep it."""

    source: str
    text: str
    comment: str = ""
    lost: str = ""


@dataclass
class Finding:
    """What flights show of one source. what: a name that other sources have, too, "motor.dc_voltage.numbers"."""

    source: str
    what: str
    found: list[Extreme]
    write: Write | None = None


Good = tuple[str, Export, list[tuple[str, Samples]]]  # name, and the samples of each source with the user's name, or ""


def learn(captures: Sequence[Path], tshark: Tshark) -> tuple[str, list[str]]:
    """Return the text of rules that all captures keep, and sentences on what they leave out. Raises YappError."""
    folder = os.path.commonpath([capture.parent for capture in captures])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        flights = list(pool.map(lambda capture: _read(capture, os.path.relpath(capture, folder), tshark), captures))
        columns = {f"{name}.{column['name']}": column for name, entry in flights[0][1].fields["messages"].items()
                   for column in entry["columns"]}  # fmt: skip
        found = {(one.source, one.what): one for one in (*_summed(flights, columns), *_shown(flights))
                 if columns.get(one.what.rpartition(".")[0], {}).get("learnable", True)}  # fmt: skip
        rules = _counted(flights)
        for one in found.values():
            # A mean has the margin of the values: those of a few flights may lie close together.
            name, _, measure = one.what.rpartition(".")
            covered = found[one.source, f"{name}.numbers"].found if measure == "mean" else one.found
            # The flights of one controller may be alike by chance: they are apart as those of most controllers.
            peers = [other.found for other in found.values() if other.what == one.what]
            below = median(_apart([low for low, _, _ in rows], -1) for rows in peers)
            above = median(_apart([high for _, high, _ in rows], 1) for rows in peers)
            rules.append(_rule(one, covered, (below, above)))
        head = HEAD.format(version=__version__, flights=count_of(len(captures), "good flight"))
        # The gate itself says which rules these flights keep.
        text, by_key = _text(head, rules), {(rule.source, rule.text): rule for rule in rules}
        verdicts = pool.map(lambda capture: tshark.ask(capture, ["check,rules=rules,json"], text)[0], captures)
        for (flight, *_), rows in zip(flights, verdicts, strict=True):
            for row in (row for row in rows if row["ok"] is not True):
                if rule := by_key.get((row["source"] or "", row["rule"])) or by_key.get(("", row["rule"])):
                    seen = " ".join(str(row[key]) for key in ("seen", "note") if row[key] is not None)
                    rule.lost = f"{flight} does not keep it ({seen})"
    said = [f"{name}: {text}" for name, export, _ in flights for text in export.lacks if not text.startswith(OF_CHECK)]
    return _text(head, rules), said


def _read(capture: Path, name: str, tshark: Tshark) -> Good:
    with scratch() as folder:
        export = tshark.export(capture, folder / "export", ["summary,json", "check,json"])
        if export.partial:
            raise CaptureError(f"{capture}: {export.partial}")
        flight = Flight(capture, export)
    names = {(row["bus"], row["id"]): row["source"] or "" for row in export.records["summary"]}
    own = [(names.get(next(iter(one.ids)), ""), one) for one in samples(flight, start=flight.start()).values()]
    return name, export, own


def _summed(flights: Sequence[Good], columns: Mapping[str, Record]) -> Iterator[Finding]:
    """Yield rates, gaps, ranges and means of the summaries, and the ratios of means. columns: by "motor.dc_current"."""
    rows = [(name, row) for name, export, _ in flights for row in export.records["summary"] if row["message"]]
    nameless = {row["message"] for _, row in rows if not row["source"]}
    found: dict[tuple[str, str], list[Extreme]] = defaultdict(list)
    means: dict[tuple[str, str, str], dict[str, Record]] = defaultdict(dict)
    for name, row in rows:
        message, seen = row["message"], {"rate": (row["rate"],) * 2, "gap": (row["gap_max"],) * 2}
        # A rule without a source is about all of its message: if one has no name, then no one is judged apart.
        source = "" if message in nameless else row["source"]
        for each, value in row["values"].items():
            seen |= {f"{each}.numbers": (value["min"], value["max"]), f"{each}.mean": (value["mean"],) * 2}
            if source and columns.get(f"{message}.{each}", {}).get("unit") in COMPARED:
                means[name, message, each][source] = value
        for what, (low, high) in seen.items():
            if low is not None:
                found[source, f"{message}.{what}"].append((float(low), float(high), name))
    for (name, message, each), values in means.items():
        own = {source: float(value["mean"] or 0) for source, value in values.items()}
        largest = max(float(value["max"] or 0) for value in values.values())
        if len(own) > 1 and largest > 0 and min(own.values()) >= largest * LEAST_LOAD:
            for source, mean in own.items():
                ratio = mean / median(own[other] for other in own if other != source)
                found[source, f"{message}.{each}.ratio"].append((ratio, ratio, name))
    return (Finding(*key, ends) for key, ends in found.items())


# ---- what values show: noise, limits over another field, and means under a condition


def _shown(flights: Sequence[Good]) -> Iterator[Finding]:
    """Yield what the values of good flights show, where they differ at all: ranges say the rest."""
    every = [(source, name, one) for name, _, own in flights for source, one in own]
    nameless = {one.message for source, _, one in every if not source}
    found: dict[tuple[str, str], list[tuple[str, Samples]]] = defaultdict(list)
    for source, name, one in every:
        found["" if one.message in nameless else source, one.message].append((name, one))
    for (source, message), own in found.items():
        less = differences(flights[0][1].fields["messages"][message])
        for finding in [*_noises(message, own), *_under_load(message, own, less)]:
            if len({end for low, high, _ in finding.found for end in (low, high)}) > 1:
                finding.source = source
                yield finding


def _noises(message: str, found: Found) -> Iterator[Finding]:
    """Yield how far values lie from the mean of their neighbours, as the rule `noise` has it."""
    lead = found[0][1]
    for name in (name for name in lead.names("value") if lead.unit_of(name) not in DEGREES):
        ends = []
        for flight, one in found:
            good = one.columns[name][np.isfinite(one.columns[name])]
            if len(good) > 2:
                noise = float(np.mean(np.abs(good[1:-1] - (good[:-2] + good[2:]) / 2)))
                ends.append((noise, noise, flight))
        yield Finding("", f"{message}.{name}.noise", ends)


def _under_load(message: str, found: Found, less: Sequence[Record]) -> Iterator[Finding]:
    """Yield limits over another field, by what fields are: of units and names alone.

    Current, power and torque over speed, temperature over current, what is less its command over the command.
    """
    one = found[0][1]
    torques = [name for name in one.measured("A") if "torque" in name]
    currents = [name for name in one.measured("A") if "torque" not in name]
    loads, speeds = currents + one.measured("W") + torques, (one.speed() or ())[:1]
    pairs = [(value, speed, LONG) for value in loads for speed in speeds]
    pairs += [(value, other, LONG) for value in one.names("value", *DEGREES) for other in currents]
    pairs += [(row["name"], row["less"], SHORT) for row in less]
    for value, other, length in pairs:
        yield from _over(message, _having(found, value, other), (value, other), (length, one.every))
    for value, other in ((value, other) for value in currents for other in torques):
        yield from _conditional(message, _having(found, value, other), value, other)


def _having(found: Found, *names: str) -> Found:
    """Return the samples that have all these fields; none where they are too few."""
    good = [(flight, one) for flight, one in found
            if all(np.isfinite(one.columns.get(name, np.nan)).any() for name in names)]  # fmt: skip
    return good if len(good) >= LEAST_FLIGHTS else []


def held(one: Samples, values: Array, length: int, every: float, breaks: Array) -> float | None:
    """Return the highest value that lasted for so many periods, or None; breaks: where a rule's condition fails."""
    good = np.isfinite(values)
    times, kept, part = one.times[good], values[good], _parts(one, every, breaks)[good]
    ends = np.searchsorted(times, times + length * every - 1e-6)
    lows = [kept[at : end + 1].min() for at, end in enumerate(ends) if end < len(kept) and part[at] == part[end]]
    return float(max(lows)) if lows else None


def _parts(one: Samples, every: float, breaks: Array) -> Array:
    """Return of each sample how many gaps, and samples without the condition, came up to it."""
    return np.asarray(np.cumsum((np.diff(one.times, prepend=one.times[:1]) > LATE * every) | breaks))


def _over(message: str, found: Found, names: tuple[str, str], hold: tuple[int, float]) -> Iterator[Finding]:
    """Yield limits over another field.

    At each point: a centre, the median of the flights' medians; how far values scatter about it; and so many of these
    as flights, as wholes, lay away for as long as the rule asks for: the gate counts a row of values outside, wherever
    they lie.
    """
    value, other = names
    rows = _curve(found, value, other)
    if len(rows) < 2:
        return
    points, centres, scatter = (np.array(each) for each in zip(*rows, strict=True))
    low_end, high_end = float(f"{points[0]:.4g}"), float(f"{points[-1]:.4g}")
    suffix = f" when={other}={low_end:.4g}..{high_end:.4g} after={AFTER:g} for={hold[0] * hold[1]:.3g}"
    ends = []
    for flight, one in found:
        x, y = one.columns[other], one.columns[value]
        breaks = (x < low_end) | (x > high_end)
        # Judged once the condition has held for so long.
        part = _parts(one, hold[1], breaks)
        starts = dict(reversed(list(zip(part[~breaks], one.times[~breaks], strict=True))))
        is_judged = ~breaks & (one.times - np.array([starts.get(each, np.inf) for each in part]) >= AFTER - 1e-6)
        away = np.abs(y - np.interp(x, points, centres)) / np.interp(x, points, scatter)
        top = held(one, np.where(is_judged, away, np.nan), *hold, breaks)
        ends += [(-top, top, flight)] if top is not None else []

    def write(low: str, high: str) -> str:
        limits = (f"{x:.4g}:{centre + float(low) * size:.4g}..{centre + float(high) * size:.4g}"
                  for x, centre, size in zip(points, centres, scatter, strict=True))  # fmt: skip
        return f"{message}.{value}.over({other})={';'.join(limits)}{suffix}"

    yield Finding("", f"{message}.{value}.over({other})", ends, write)


def _curve(found: Found, value: str, other: str) -> list[tuple[float, float, float]]:
    """Return point, centre and scatter of values over another field: where enough flights have enough samples."""
    pairs = []
    for x, y in ((one.columns[other], one.columns[value]) for _, one in found):
        good = np.isfinite(x) & np.isfinite(y)
        good[good] = np.abs(x[good]) > RUNNING * np.max(np.abs(x[good]), initial=0.0)
        pairs.append((x[good], y[good]))
    if not any(len(x) for x, _ in pairs):
        return []
    every_x, every_y = (np.concatenate(each) for each in zip(*pairs, strict=True))
    low, high = np.quantile(every_x, USUAL)
    grid = np.linspace(low, high, POINTS)
    width = (grid[1] - grid[0]) / 2
    floor = LEAST_SHARE * float(np.quantile(every_y, 0.98) - np.quantile(every_y, 0.02))
    rows = []
    for at in grid if min(width, floor) > 0 else ():
        own = [y[np.abs(x - at) <= width] for x, y in pairs]
        medians, y = [float(np.median(y)) for y in own if len(y)], np.concatenate(own)
        if len(medians) >= LEAST_FLIGHTS and len(y) >= LEAST_SAMPLES:
            centre, near = float(np.median(medians)), every_x[np.abs(every_x - at) <= width]
            scatter = 1.4826 * float(np.median(np.abs(y - centre)))
            rows.append((float(np.median(near)), centre, max(scatter, floor)))
    return rows


def _conditional(message: str, found: Found, value: str, other: str) -> Iterator[Finding]:
    """Yield the mean at the lowest and at the highest values of another field, if each flight has some of these."""
    every = np.concatenate([one.columns[other] for _, one in found] or [np.zeros(0)])
    for quantile, sign in ((1 - RARE, 1), (RARE, -1)) if len(every) else ():
        edge, ends = float(f"{np.nanquantile(every, quantile):.2g}"), []
        for flight, one in found:
            y = one.columns[value][(sign * one.columns[other] >= sign * edge) & np.isfinite(one.columns[value])]
            if len(y) >= LEAST_HELD:
                ends.append((float(y.mean()), float(y.mean()), flight))
        if sign * edge > 0 and len(ends) == len(found):
            name, when = f"{message}.{value}.mean", f"{edge:g}.." if sign > 0 else f"..{edge:g}"

            def write(low: str, high: str, name: str = name, when: str = when) -> str:
                return f"{name}={low}..{high} when={other}={when}"

            yield Finding("", f"{name} {other} {sign}", ends, write)


# ---- limits


def _rule(one: Finding, covered: list[Extreme], apart: tuple[float, float]) -> Rule:
    """Return the rule of what was seen, wide enough for each flight to keep it that had no part in it.

    covered: what the margin is a share of; apart: how far flights are apart at least, below and above.
    """
    measure = one.what.rpartition(".")[2]
    wanted = one.found if len({name for _, _, name in one.found}) >= LEAST_TRIED else []

    def ends(left_out: str, room: float) -> tuple[str, str, str]:
        rest, own = ([row for row in rows if row[2] != left_out] for rows in (one.found, covered))
        low = 0.0 if measure in ("rate", *UPPER) else min(low for low, _, _ in own or covered)
        share = MARGIN * (max(high for _, high, _ in own or covered) - low)
        room *= ROOM_OF_RATIO if measure == "ratio" else 1
        top, highest = _limit([(high, name) for _, high, name in rest], share, 1, apart[1], room)
        bottom, lowest = _limit([(low, name) for low, _, name in rest], share, -1, apart[0], room)
        return bottom, top, highest if measure in UPPER else f"{lowest}, {highest}"

    broken = 0
    for room in ROOMS:
        tried = [(ends(name, room), low, high) for low, high, name in wanted]
        broken = sum(float(bottom) > low or high > float(top) for (bottom, top, _), low, high in tried)
        if not broken:
            break
    bottom, top, comment = ends("", room)
    lost = f"flights differ too much: {broken} of {len(wanted)} do not keep it" if broken else ""
    # A field of the user's may have the name of a measure.
    name = re.sub(r"\.(count|rate|gap)\.numbers$", r".\1.value", one.what).removesuffix(".numbers")
    text = f"{name}={top}" if measure in UPPER else f"{name}={bottom}..{top}"
    return Rule(one.source, one.write(bottom, top) if one.write else text, comment, lost)


def _apart(values: Sequence[float], sign: int) -> float:
    """Return how far the extreme of flights, above (sign 1) or below (-1), lies beyond the median flight's."""
    return abs(max(values, key=lambda value: sign * value) - median(values))


def _limit(
    ends: list[tuple[float, str]], share: float, sign: int, apart: float = 0.0, room: float = 1.0
) -> tuple[str, str]:
    """Return the limit above (sign 1) or below (-1) what was seen, and the extreme that it comes from.

    It lies beyond the extreme by the margin, and by 1.5 times as much as flights are apart, at least `apart`: where
    flights differ, the next one differs, too. An extreme of 0 is most likely a bound, such as that of a motor that
    stands: beyond it is room for noise only. room: the share of all that which it has.
    """
    extreme, name = max(ends, key=lambda end: sign * end[0])
    apart = max(apart, _apart([value for value, _ in ends], sign))
    beyond = (max(share, MARGIN * LEAST_RANGE * abs(extreme)) + 1.5 * apart) * room if extreme else share * NOISE
    limit = extreme
    if beyond:  # of which two digits are written
        scale = 10.0 ** (1 - math.floor(math.log10(beyond)))
        limit = sign * math.ceil(round(sign * (extreme + sign * beyond) * scale, 6)) / scale
    return np.format_float_positional(limit, precision=12, trim="-"), f"{extreme:.7g} in {name}"


def _counted(flights: Sequence[Good]) -> list[Rule]:
    """Return the rules of `check` alone: each with 0, or with what good flights have."""
    seen: dict[str, dict[str, float]] = defaultdict(dict)
    for name, export, _ in flights:
        for row in export.records["check"]:
            counts = seen[row["rule"].partition("=")[0]]
            counts[name] = max(counts.get(name, 0.0), float(row["seen"] or 0))
    rules = []
    for kind, counts in seen.items():
        ends = [(count, name) for name, count in counts.items()]
        limit, most = _limit(ends, max(counts.values()) * MARGIN, 1)
        whole = math.ceil(float(limit))
        rules.append(Rule("", f"{kind}={whole}", most if whole else ""))
    return rules


def _text(head: str, rules: list[Rule]) -> str:
    lines = [head]
    for source in sorted({rule.source for rule in rules}):
        own = [rule for rule in rules if rule.source == source]
        if source:
            lines.append(f"\n{'# ' * all(rule.lost for rule in own)}source={source}\n")
        for rule in own:
            comment = f"{rule.text:<48} # {rule.comment}" if rule.comment else rule.text
            lines.append(f"# {rule.text}: {rule.lost}\n" if rule.lost else f"{comment}\n")
    return "".join(lines)
