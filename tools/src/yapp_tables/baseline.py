# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits learnt from good flights: rules for -z yapp,check, which then judges whether a flight is like these."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from statistics import median

from . import __version__
from .config import Config
from .errors import CaptureError, count_of
from .scratch import scratch
from .tshark import Record

# A range that is narrow for its value counts as this share of the value: what never changed may do so a little.
LEAST_RANGE = Decimal("0.25")
NOISE = Decimal("0.1")  # of the margin, beyond an extreme of 0
HEAD = """\
# Learnt by yapp-tables {version} from {flights}, with a margin of {margin} %.
# A # takes a rule out; edit the numbers as you like. Behind each: the extreme of the good flights, and whose it is.
"""
Extreme = tuple[Decimal, Decimal, str]  # the lowest and the highest of a source in a flight, the flight


@dataclass
class Rule:
    """A rule. source: the user's name of the one it is about, "" for all; lost: which good flight does not keep it."""

    source: str
    text: str
    comment: str
    lost: str = ""


def learn(captures: Sequence[Path], config: Config, margin: Decimal) -> tuple[str, list[str]]:
    """Return the text of a file of rules that all captures keep, and sentences on what they leave out.

    margin: a share of the range that the captures cover. Raises YappError.
    """
    folder = os.path.commonpath([capture.parent for capture in captures])
    names = [os.path.relpath(capture, folder) for capture in captures]
    with ThreadPoolExecutor(os.cpu_count()) as pool, scratch() as aside:

        def ask(*statistics: str) -> list[tuple[list[Record], list[str]]]:
            return list(pool.map(lambda path: config.of(path)[0].ask(path, str(aside), statistics), captures))

        told = ask("summary,json", "compare,json")
        extremes = _extremes({name: records for name, (records, _) in zip(names, told, strict=True)})
        if not extremes:
            raise CaptureError(f"no message was decoded in {', '.join(names)}")
        rules = [_rule(source, what, found, margin) for (source, what), found in extremes.items()]
        rules.append(Rule("", "absent=0", "all that yapp.sources names with a message came"))
        share = f"{(margin * 100).normalize():f}"
        head = HEAD.format(version=__version__, flights=count_of(len(captures), "good flight"), margin=share)
        # The gate itself says which rules these flights keep: a reserved value, for one, lies in no range.
        Path(aside, "rules").write_text(_text(head, rules), encoding="utf-8")
        for name, (verdicts, _) in zip(names, ask("check,rules=rules,json"), strict=True):
            _mark_lost(rules, name, verdicts)
    said = [f"{name}: {text}" for name, (_, texts) in zip(names, told, strict=True) for text in texts]
    return _text(head, rules), said


def _extremes(flights: dict[str, list[Record]]) -> dict[tuple[str, str], list[Extreme]]:
    """Return what was seen, by source and what a rule is about: "motor.rate", "motor.dc_voltage"."""
    rows = [(name, row) for name, records in flights.items() for row in records if row["message"]]
    # A rule without a source is about all of its message: if one has no name, then no one is judged apart.
    nameless = {row["message"] for _, row in rows if "rate" in row and not row["source"]}
    found = defaultdict(list)
    for name, row in rows:
        message, seen = row["message"], {}
        source = "" if "spread" in row or message in nameless else row["source"]
        if row.get("spread"):  # of values that never differed, their ranges say it
            seen = {f"{row['field']}.spread": (row["spread"], row["spread"])}
        elif "rate" in row:
            seen = {"rate": (row["rate"], row["rate"]), "gap": (row["gap_max"], row["gap_max"])}
            seen |= {field: (value["min"], value["max"]) for field, value in row["values"].items()}
        for what, (low, high) in seen.items():
            if low is not None:
                found[source, f"{message}.{what}"].append((Decimal(low), Decimal(high), name))
    return found


def _rule(source: str, what: str, found: list[Extreme], margin: Decimal) -> Rule:
    kind = what.rpartition(".")[2]
    from_zero = kind in ("rate", "gap", "spread")
    covered = max(high for _, high, _ in found) - (0 if from_zero else min(low for low, _, _ in found))
    top, highest = _limit([(high, name) for _, high, name in found], covered * margin, margin, 1)
    bottom, lowest = _limit([(low, name) for low, _, name in found], covered * margin, margin, -1)
    if kind in ("gap", "spread"):
        return Rule(source, f"{what}={top}", highest)
    return Rule(source, f"{what}={bottom}..{top}", f"{lowest}, {highest}")


def _limit(ends: list[tuple[Decimal, str]], share: Decimal, margin: Decimal, sign: int) -> tuple[str, str]:
    """Return the limit above (sign 1) or below (-1) what was seen, and the extreme that it comes from.

    It lies beyond the extreme by the margin, and by twice as much as this lies beyond the median flight's: where
    flights differ, the next one differs, too. An extreme of 0 is most likely a bound, such as that of a motor that
    stands: beyond it is room for noise only.
    """
    extreme, name = max(ends, key=lambda end: sign * end[0])
    beyond = max(share, margin * LEAST_RANGE * abs(extreme)) + 2 * abs(extreme - median(value for value, _ in ends))
    beyond = beyond if extreme else share * NOISE
    limit = extreme
    if beyond:
        digits = Decimal(1).scaleb(beyond.adjusted() - 1)
        limit = (extreme + sign * beyond).quantize(digits, ROUND_CEILING if sign > 0 else ROUND_FLOOR)
    return f"{limit.normalize():f}", f"{extreme:.7g} in {name}"


def _mark_lost(rules: list[Rule], name: str, verdicts: list[Record]) -> None:
    by_key = {(rule.source, rule.text): rule for rule in rules}
    for verdict in verdicts:
        text = verdict["rule"]
        rule = by_key.get((verdict["source"] or "", text)) or by_key.get(("", text))
        if rule and verdict["ok"] is not True:
            seen = " ".join(str(verdict[key]) for key in ("seen", "note") if verdict[key] is not None)
            rule.lost = f"{name} does not keep it ({seen})"


def _text(head: str, rules: list[Rule]) -> str:
    lines = [head]
    for source in sorted({rule.source for rule in rules}):
        own = [rule for rule in rules if rule.source == source]
        if source:
            lines.append(f"\n{'# ' * all(rule.lost for rule in own)}source={source}\n")
        lines += [
            f"# {rule.text}: {rule.lost}\n" if rule.lost else f"{rule.text:<40} # {rule.comment}\n" for rule in own
        ]
    return "".join(lines)
