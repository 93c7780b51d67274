# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits learnt from good flights: rules for -z yapp,check, which then judges whether a flight is like these."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from . import __version__, loads
from .config import Config
from .errors import CaptureError, count_of
from .scratch import scratch
from .tshark import Record

# A range that is narrow for its value counts as this share of the value: what never changed may do so a little.
LEAST_RANGE = Decimal("0.25")
NOISE = Decimal("0.1")  # of the margin, beyond an extreme of 0
# What differs from flight to flight, such as speed and battery, is the same for all controllers: their ratio keeps to
# this share of the room.
ROOM_OF_RATIO = Decimal("0.5")
COMPARED = ("A", "RPM", "°C")  # units of the fields that have a ratio
UPPER = ("gap", "spread", "noise")  # measures with an upper limit only
LEAST_TRIED = 4  # flights: fewer say nothing of one that has no part
ROOMS = (Decimal(1), Decimal("1.5"), Decimal("2.5"))  # of a limit, until each flight keeps it that has no part in it
LEAST_LOAD = Decimal("0.1")  # of the largest current, that a mean is where a ratio tells something
HEAD = """\
# Learnt by yapp-tables {version} from {flights}, with a margin of {margin} %.
# A # takes a rule out; edit the numbers as you like. Behind each: the extreme of the good flights, and whose it is.
# The first rules are those of check alone. Reserved values are in no range; .special is their share.
"""
LEAST_SHARE = Decimal("0.05")  # of values, that may be reserved in any flight
OF_CHECK = "damaged or lost messages may hide faults"  # what check says, and the rules count
Extreme = tuple[Decimal, Decimal, str]  # the lowest and the highest of a source in a flight, the flight


@dataclass
class Rule:
    """A rule. source: the user's name of the one it is about, "" for all; lost: which good flight does not keep it.

    seen: what the gate saw in each flight.
    """

    source: str
    text: str
    comment: str = ""
    lost: str = ""
    seen: list[tuple[Decimal, str]] = field(default_factory=list)


def learn(captures: Sequence[Path], config: Config, margin: Decimal) -> tuple[str, list[str]]:
    """Return the text of a file of rules that all captures keep, and sentences on what they leave out.

    margin: a share of the range that the captures cover. Raises YappError.
    """
    folder = os.path.commonpath([capture.parent for capture in captures])
    names = [os.path.relpath(capture, folder) for capture in captures]
    with ThreadPoolExecutor(os.cpu_count()) as pool, scratch() as aside:
        folders = [Path(aside, str(number)) for number in range(len(captures))]
        for path in folders:
            path.mkdir()
            (path / "rules").symlink_to(Path(aside, "rules"))

        def ask(*statistics: str) -> list[tuple[list[Record], list[str]]]:
            def one(path: Path, own: Path) -> tuple[list[Record], list[str]]:
                return config.of(path)[0].ask(path, str(own), statistics)

            return list(pool.map(one, captures, folders))

        told = dict(zip(names, ask("csv,csv", "summary,json", "compare,json", "check,json"), strict=True))
        flights = {name: records for name, (records, _) in told.items()}
        extremes = _extremes(flights)
        if not extremes:
            raise CaptureError(f"no message was decoded in {', '.join(names)}")
        fields = config.of(captures[0])[0].fields()[0]
        samples = loads.by_source(
            [row for name, own in zip(names, folders, strict=True) for row in loads.read(own / "csv", name, fields)]
        )
        extremes |= loads.noises(fields, samples)
        writers = {}
        for finding in loads.findings(fields, samples):
            if len({end for low, high, _ in finding.found for end in (low, high)}) < 2:
                continue  # none, or what never differs: its range says it
            extremes[finding.source, finding.what] = finding.found
            writers[finding.source, finding.what] = finding.write
        rules = _counted(flights, margin)
        apart = _least_apart(extremes)
        for (source, what), found in extremes.items():
            # A mean has the margin of the values: those of a few flights may lie close together.
            field, _, measure = what.rpartition(".")
            covered = extremes[source, f"{field}.numbers"] if measure == "mean" else found
            rules.append(_rule(source, what, (found, covered, apart[what]), margin, writers.get((source, what))))
        shares, constants = _reserved(extremes, fields), _constants(extremes, fields)
        constants += [Rule(source, text, "always") for source, text in loads.constant_flags(fields, samples)]
        share = f"{(margin * 100).normalize():f}"
        head = HEAD.format(version=__version__, flights=count_of(len(captures), "good flight"), margin=share)
        # The gate itself says which rules these flights keep, and what part of the values is reserved.
        Path(aside, "rules").write_text(_text(head, [*rules, *shares, *constants]), encoding="utf-8")
        verdicts = {name: rows for name, (rows, _) in zip(names, ask("check,rules=rules,json"), strict=True)}
        _mark_lost([*rules, *shares, *constants], verdicts)
        rules += [rule for rule in shares if _learn_share(rule, margin)]
        rules += [rule for rule in constants if rule.seen and not rule.lost]
    said = [f"{name}: {text}" for name, (_, texts) in told.items() for text in texts if not text.startswith(OF_CHECK)]
    return _text(head, rules), said


def _extremes(flights: dict[str, list[Record]]) -> dict[tuple[str, str], list[Extreme]]:
    """Return what was seen, by source and the name of a rule: "motor.rate", "motor.dc_voltage.numbers"."""
    rows = [(name, row) for name, records in flights.items() for row in records if row["message"] and "rule" not in row]
    # A rule without a source is about all of its message: if one has no name, then no one is judged apart.
    nameless = {row["message"] for _, row in rows if "rate" in row and not row["source"]}
    found = defaultdict(list)
    for name, row in rows:
        message, seen = row["message"], dict[str, tuple[Any, Any]]()
        source = "" if "spread" in row or message in nameless else row["source"]
        if row.get("unit") in COMPARED and message not in nameless:
            for other, ratio in _ratios(row["sources"]).items():
                found[other, f"{message}.{row['field']}.ratio"].append((ratio, ratio, name))
        if row.get("spread"):  # of values that never differed, their ranges say it
            seen = {f"{row['field']}.spread": (row["spread"], row["spread"])}
        elif "rate" in row:
            for measure, value in (("rate", row["rate"]), ("gap", row["gap_max"])):
                seen[measure] = value, value
            for field, value in row["values"].items():
                seen[f"{field}.numbers"] = value["min"], value["max"]
                seen[f"{field}.mean"] = value["mean"], value["mean"]
        for what, (low, high) in seen.items():
            if low is not None:
                found[source, f"{message}.{what}"].append((Decimal(low), Decimal(high), name))
    return found


def _ratios(sources: Sequence[Record]) -> dict[str, Decimal]:
    """Return by source its mean, divided by the median of the others' means; nothing where a mean is about 0."""
    means = {each["source"]: Decimal(each["mean"] or 0) for each in sources}
    largest = max(Decimal(each["max"] or 0) for each in sources)
    if len(means) < 2 or largest <= 0 or min(means.values()) < largest * LEAST_LOAD:
        return {}
    return {one: mean / median(means[other] for other in means if other != one) for one, mean in means.items()}


def _least_apart(extremes: dict[tuple[str, str], list[Extreme]]) -> dict[str, tuple[Decimal, Decimal]]:
    """Return by name of a rule how far flights are apart at least, below and above.

    The flights of one controller may be alike by chance: they are apart as those of most controllers, and by a step of
    the field, which is the least distance of two of its lowest, or highest, values.
    """
    sources = defaultdict(list)
    for (_, what), found in extremes.items():
        sources[what].append(found)
    least = {}
    for what, peers in sources.items():
        field, _, measure = what.rpartition(".")
        numbers = sources.get(f"{field}.numbers", []) if measure in ("numbers", "spread") else []
        lows = sorted({low for found in numbers for low, _, _ in found})
        highs = sorted({high for found in numbers for _, high, _ in found})
        steps = [after - before for values in (lows, highs) for before, after in pairwise(values)]
        step = min(steps, default=Decimal(0))
        below = median(_apart([low for low, _, _ in found], -1) for found in peers)
        above = median(_apart([high for _, high, _ in found], 1) for found in peers)
        least[what] = max(step, below), max(step, above)
    return least


def _rule(
    source: str,
    what: str,
    seen: tuple[list[Extreme], list[Extreme], tuple[Decimal, Decimal]],
    margin: Decimal,
    write: Callable[[str, str], str] | None = None,
) -> Rule:
    """Return the rule of what was seen, wide enough for each flight to keep it that had no part in it.

    seen: the extremes, what the margin is a share of, and how far flights are apart at least, below and above;
    write: limits to a text, None for the rule that `what` names.
    """
    found, covered, apart = seen
    measure = what.rpartition(".")[2]
    wanted = found if len(found) >= LEAST_TRIED else []
    for room in ROOMS:
        broken = []
        for low, high, name in wanted:
            rest, own = ([row for row in rows if row[2] != name] for rows in (found, covered))
            if rest:
                bottom, top, _ = _ends(measure, rest, own or covered, apart, margin, room)
                broken += [name] if Decimal(bottom) > low or high > Decimal(top) else []
        if not broken:
            break
    bottom, top, comment = _ends(measure, found, covered, apart, margin, room)
    lost = f"flights differ too much: {len(broken)} of {len(wanted)} do not keep it" if broken else ""
    if write:
        return Rule(source, write(bottom, top), comment, lost)
    if measure in UPPER:
        return Rule(source, f"{what}={top}", comment.rpartition(", ")[2], lost)
    # A field of the user's may have the name of a measure.
    text = re.sub(r"\.(count|rate|gap)\.numbers$", r".\1.value", what).removesuffix(".numbers")
    return Rule(source, f"{text}={bottom}..{top}", comment, lost)


def _ends(
    measure: str,
    found: list[Extreme],
    covered: list[Extreme],
    apart: tuple[Decimal, Decimal],
    margin: Decimal,
    room: Decimal,
) -> tuple[str, str, str]:
    """Return the limits below and above, and the extremes that they come from."""
    from_zero = measure in ("rate", *UPPER)
    share = margin * (max(high for _, high, _ in covered) - (0 if from_zero else min(low for low, _, _ in covered)))
    if measure == "ratio":
        room *= ROOM_OF_RATIO
    top, highest = _limit([(high, name) for _, high, name in found], share, margin, 1, apart[1], room)
    bottom, lowest = _limit([(low, name) for low, _, name in found], share, margin, -1, apart[0], room)
    return bottom, top, f"{lowest}, {highest}"


def _apart(values: Sequence[Decimal], sign: int) -> Decimal:
    """Return how far the extreme of flights, above (sign 1) or below (-1), lies beyond the median flight's."""
    return abs(max(values, key=lambda value: sign * value) - median(values))


def _limit(
    ends: list[tuple[Decimal, str]],
    share: Decimal,
    margin: Decimal,
    sign: int,
    apart: Decimal = Decimal(0),
    room: Decimal = Decimal(1),
) -> tuple[str, str]:
    """Return the limit above (sign 1) or below (-1) what was seen, and the extreme that it comes from.

    It lies beyond the extreme by the margin, and by twice as much as flights are apart, at least `apart`: where flights
    differ, the next one differs, too. An extreme of 0 is most likely a bound, such as that of a motor that stands:
    beyond it is room for noise only. room: the share of all that which it has.
    """
    extreme, name = max(ends, key=lambda end: sign * end[0])
    apart = max(apart, _apart([value for value, _ in ends], sign))
    beyond = (max(share, margin * LEAST_RANGE * abs(extreme)) + 2 * apart) * room
    beyond = beyond if extreme else share * NOISE
    limit = extreme
    if beyond:
        digits = Decimal(1).scaleb(beyond.adjusted() - 1)
        limit = (extreme + sign * beyond).quantize(digits, ROUND_CEILING if sign > 0 else ROUND_FLOOR)
    return f"{limit.normalize():f}", f"{extreme:.7g} in {name}"


def _counted(flights: dict[str, list[Record]], margin: Decimal) -> list[Rule]:
    """Return the rules of `check` alone: each with 0, or with what good flights have."""
    seen: dict[str, dict[str, Decimal]] = defaultdict(dict)
    for name, records in flights.items():
        for row in records:
            if "rule" in row:
                counts = seen[row["rule"].partition("=")[0]]
                counts[name] = max(counts.get(name, Decimal(0)), Decimal(row["seen"] or 0))
    rules = []
    for kind, counts in seen.items():
        ends = [(count, name) for name, count in counts.items()]
        limit, most = _limit(ends, max(counts.values()) * margin, margin, 1)
        whole = Decimal(limit).to_integral_value(ROUND_CEILING)
        rules.append(Rule("", f"{kind}={whole}", most if whole else ""))
    return rules


def _reserved(extremes: dict[tuple[str, str], list[Extreme]], fields: Record) -> list[Rule]:
    """Return a rule for each compressed float, that none of its values is reserved."""
    floats = {
        f"{message}.{column['name'].removesuffix('_special')}.numbers"
        for message, entry in fields["messages"].items()
        for column in entry["columns"]
        if column["name"].endswith("_special")
    }
    return [Rule(source, f"{what.removesuffix('.numbers')}.special=0") for source, what in extremes if what in floats]


def _constants(extremes: dict[tuple[str, str], list[Extreme]], fields: Record) -> list[Rule]:
    """Return a rule for each meaning of each enum, that it always has this one: good flights keep one or none."""
    return [
        Rule(source, f"{message}.{column['name']}={number}..{number}", text)
        for source, message in dict.fromkeys((source, what.partition(".")[0]) for source, what in extremes)
        for column in fields["messages"][message]["columns"]
        for number, text in (column.get("values") or {}).items()
    ]


def _learn_share(rule: Rule, margin: Decimal) -> bool:
    """Set the share of values that may be reserved. Returns whether a flight may break the rule."""
    if not rule.seen:
        return False
    limit, rule.comment = _limit(rule.seen, max(share for share, _ in rule.seen) * margin, margin, 1)
    rule.text = f"{rule.text.partition('=')[0]}={max(Decimal(limit), LEAST_SHARE)}"
    rule.lost = ""
    return Decimal(limit) < 1


def _mark_lost(rules: list[Rule], flights: dict[str, list[Record]]) -> None:
    """Note what the gate says of the rules."""
    by_key = {(rule.source, rule.text): rule for rule in rules}
    for name, verdicts in flights.items():
        for verdict in verdicts:
            text = verdict["rule"]
            rule = by_key.get((verdict["source"] or "", text)) or by_key.get(("", text))
            if rule and verdict["seen"] is not None:
                rule.seen.append((Decimal(verdict["seen"]), name))
            if rule and verdict["ok"] is not True:
                seen = " ".join(str(verdict[key]) for key in ("seen", "note") if verdict[key] is not None)
                rule.lost = f"{name} does not keep it ({seen})"


def _text(head: str, rules: list[Rule]) -> str:
    lines = [head]
    for source in sorted({rule.source for rule in rules}):
        own = [rule for rule in rules if rule.source == source]
        if source:
            lines.append(f"\n{'# ' * all(rule.lost for rule in own)}source={source}\n")
        lines += [_line(rule) for rule in own]
    return "".join(lines)


def _line(rule: Rule) -> str:
    if rule.lost:
        return f"# {rule.text}: {rule.lost}\n"
    return f"{rule.text:<48} # {rule.comment}\n" if rule.comment else f"{rule.text}\n"
