# SPDX-License-Identifier: GPL-2.0-or-later
"""Rules with conditions, hold times and limits that depend on another field: random series of messages against a model that
knows nothing of the plugin's.  Times are whole milliseconds, and limits lie between the values that counts have."""
import dataclasses
import json
import random
import re
import struct

import pytest
import test_gate
from can_generator import Sent

import levels
import tshark

LATE = 250  # ms: 2.5 periods of 100
SOURCES = [(0, 0x210), (0, 0x211), (1, 0x210)]
TOP16, TOP8 = 65530, 250  # the highest counts that are numbers
SPANS = {"dc_voltage": (-128, 128, TOP16), "dc_current": (-128, 128, TOP16), "rpm_measured": (-60000, 60000, TOP16),
         "rpm_commanded": (-60000, 60000, TOP16), "motor_temperature": (-40, 210, TOP8)}
FLAGS = {"status.enabled": 0x20000, "status.braking": 0x8000, "fault.motor_overcurrent": 0x10000}
JUDGED = [*SPANS, "rpm_error"]


@dataclasses.dataclass
class Message:
    at: int  # ms
    frame: int
    counts: dict
    mode: int
    flags: dict
    is_reboot: bool

    def number(self, field):
        """The value; None if it is reserved."""
        if field == "motor_mode":
            return self.mode
        if field == "rpm_error":
            ends = self.number("rpm_measured"), self.number("rpm_commanded")
            return None if None in ends else ends[0] - ends[1]
        low, high, top = SPANS[field]
        count = self.counts[field]
        return None if count > top else low + count * (high - low) / top


def series_of(rng, count):
    """What one controller sends: values that wander, flags that stay for a while, gaps, and reboots."""
    at, clock, found = rng.randrange(100), 10**6, []
    flags = dict.fromkeys(FLAGS, False)
    state = {field: rng.randrange(top) for field, (*_, top) in SPANS.items()}
    for _ in range(count):
        step = rng.choice([60, 100, 100, 100, 140, 250, 251]) if rng.random() < 0.95 else rng.randrange(260, 900)
        is_reboot = clock > 2000 and rng.random() < 0.02
        at, clock = at + step, rng.randrange(1000) if is_reboot else clock + step
        for name in flags:
            flags[name] ^= rng.random() < 0.1
        for field, (*_, top) in SPANS.items():
            state[field] = min(max(state[field] + round(rng.gauss(0, top / 25)), 0), top)
        counts = {field: value if rng.random() > 0.06 else SPANS[field][2] + 1 + rng.randrange(5)
                  for field, value in state.items()}
        found.append((Message(at, 0, counts, int(rng.random() < 0.8), dict(flags), is_reboot), clock))
    return found


def payload(message, clock):
    bits = {name: sum(bit for word, bit in FLAGS.items() if word.startswith(name) and message.flags[word]) for name in
            ("status", "fault")}
    field = message.counts.get
    return struct.pack("<6HBBIIqBB", 32765, 32765, field("rpm_commanded"), field("rpm_measured"), field("dc_voltage"),
                       field("dc_current"), field("motor_temperature"), message.mode, bits["status"], bits["fault"],
                       clock * 10**6, 1, 80)


def write(path, rng):
    """Write a capture; return by bus and ID the messages in it."""
    sent = []
    for source in SOURCES:
        for seq, (message, clock) in enumerate(series_of(rng, 120)):
            sent.append((message.at, source, seq % 256, message, clock))
    sent.sort(key=lambda one: one[:3])
    placed, by_source = [], {source: [] for source in SOURCES}
    for at, (bus, ident), seq, message, clock in sent:
        for frame in Sent(ident, 0, seq, payload(message, clock)).frames():
            frame.bus = bus
            placed.append((test_gate.BEGIN + at * 10**6, frame))
        message.frame = len(placed)
        by_source[bus, ident].append(message)
    path.write_bytes(test_gate.pcapng(placed, ("can0", "can1")))
    return by_source


# The model ---------------------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Rule:
    field: str
    points: list  # of (x, low, high); one where the limits are constant
    other: str = ""
    tests: tuple = ()  # (text, function of a message)
    after: int = 0  # ms
    hold: int = 0

    def text(self):
        def ends(low, high):
            return f"{'' if low is None else low}..{'' if high is None else high}"
        limits = ends(*self.points[0][1:])
        if self.other:
            limits = ";".join(f"{x}:{ends(low, high)}" for x, low, high in self.points)
        suffixes = [f"when={'&'.join(text for text, _ in self.tests)}"] if self.tests else []
        suffixes += [f"after={self.after / 1000}"] if self.after else []
        suffixes += [f"for={self.hold / 1000}"] if self.hold else []
        return " ".join([f"motor.{self.field}{f'.over({self.other})' * bool(self.other)}={limits}", *suffixes])


def condition(tests, message):
    """True, False, or None where a value that it needs is reserved."""
    results = [test(message) for _, test in tests]
    return False if False in results else None if None in results else True


def limits_of(rule, message):
    """The lowest and the highest value at a message; None where it is not judged."""
    if not rule.other:
        return rule.points[0][1:]
    x = message.number(rule.other)
    if x is None or not rule.points[0][0] <= x <= rule.points[-1][0]:
        return None
    for (x1, *first), (x2, *second) in zip(rule.points, rule.points[1:]):
        if x1 <= x <= x2:
            return [None if a is None else a + (b - a) * (x - x1) / (x2 - x1) for a, b in zip(first, second)]


def judge(rule, messages):
    """What the rule has to say of one controller: (ok, number of violations, [(margin, frame)] of the values to name)."""
    since, row, broken, seen, last = None, [], {}, [], None
    for message in messages:
        if message.is_reboot or last is not None and message.at - last > LATE:
            since, row = None, []
        last = message.at
        holds = condition(rule.tests, message)
        if holds is None:
            continue
        if not holds:
            since, row = None, []
            continue
        since = message.at if since is None else since
        limits, value = limits_of(rule, message), message.number(rule.field)
        if message.at - since < rule.after or limits is None or value is None:
            continue
        low, high = limits
        margin = min(value - low if low is not None else float("inf"), high - value if high is not None else float("inf"))
        seen.append((margin, message.frame))
        row = [*row, (margin, message.frame, message.at)] if margin < 0 else []
        if row and message.at - row[0][2] >= rule.hold:
            broken |= {frame: margin for margin, frame, _ in row}
    if not seen:
        return None, None, []
    return not broken, len(broken), [(margin, frame) for frame, margin in broken.items()] or seen


def random_rule(rng):
    def limit(field):  # between two counts
        low, high, top = SPANS.get(field, (-60000, 60000, TOP16))
        return low + (round(rng.uniform(0.1, 0.9) * top) + 0.5) * (high - low) / top

    def ends(field):
        low, high = sorted((limit(field), limit(field)))
        kind = rng.random()
        return (None, high) if kind < 0.2 else (low, None) if kind < 0.4 else (low, high)

    def test():
        if rng.random() < 0.6:
            name, is_not = rng.choice(list(FLAGS)), rng.random() < 0.4
            return "!" * is_not + name, lambda message: message.flags[name] != is_not
        if rng.random() < 0.3:
            return "motor_mode=1", lambda message: message.mode == 1
        field = rng.choice(list(SPANS))
        low, high = sorted((limit(field), limit(field)))

        def is_within(message):
            value = message.number(field)
            return None if value is None else low <= value <= high
        return f"{field}={low}..{high}", is_within

    field, points, other = rng.choice(JUDGED), [], ""
    points = [(0, *ends(field))]
    if rng.random() < 0.4:
        other = rng.choice([name for name in SPANS if name != field])
        points = [(x, *sorted((limit(field), limit(field)))) for x in sorted({limit(other) for _ in range(rng.randrange(2, 5))})]
        if len(points) < 2:
            other, points = "", [(0, *points[0][1:])]
    tests = tuple(test() for _ in range(rng.choice([0, 1, 1, 2])))
    return Rule(field, points, other, tests, rng.choice([0, 0, 300, 1000]), rng.choice([0, 0, 200, 500, 1000]))


def check(path, rules, code=None):
    done = tshark.run("-q", "-r", path, "-o", "yapp.motor_ids:0x210,0x211", "-z", f"yapp,check,json,unknown=0,{','.join(rules)}",
                      check=False)
    assert code is None or done.returncode == code, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    return {(row["rule"], row["bus"], row["id"]): row for row in rows}


@pytest.mark.parametrize("seed", range(levels.size(4, 40)))
def test_random_rules(folder, seed):
    rng = random.Random(f"rules {seed}")
    by_source = write(folder / "run.pcapng", rng)
    rules = [random_rule(rng) for _ in range(40)]
    found, kinds = check(folder / "run.pcapng", [rule.text() for rule in rules]), set()
    for rule in rules:
        for (bus, ident), messages in by_source.items():
            ok, count, named = judge(rule, messages)
            row = found[rule.text(), f"can{bus}", ident]
            kinds.add(ok)
            assert (row["ok"], row["seen"]) == (ok, count), (rule, row)
            if ok is None:
                assert "never" in row["note"] or "reserved" in row["note"], row
                continue
            least = min(named)[0]
            digits = 0.1 if "rpm" in rule.field else 0.002  # people see so many
            assert row["margin"] == pytest.approx(least, abs=digits), (rule, row)
            assert row["frame"] in [frame for margin, frame in named if margin <= least + digits], (rule, row)
            was_outside = ok and abs(least) > digits and least < 0
            assert not was_outside or row["note"].endswith("outside, but not for so long"), (rule, row)
            kinds.add("outside" if was_outside else ok)
    assert kinds == {True, False, None, "outside"}


def test_means_shares_and_spreads_under_a_condition(folder):
    """Of the messages that are judged alone; a controller whose condition does not hold has no part in a spread."""
    rng = random.Random(7)
    by_source = write(folder / "run.pcapng", rng)
    tests = [("status.enabled", lambda message: message.flags["status.enabled"]),
             ("!status.braking", lambda message: not message.flags["status.braking"])]
    rule = Rule("dc_voltage", [(0, None, None)], tests=tuple(tests))
    words = " when=status.enabled&!status.braking"
    names = [f"motor.dc_voltage.{measure}{words}" for measure in ("mean=-200..200", "special=1", "spread=0.5", "noise=9")]
    found, latest, widest = check(folder / "run.pcapng", names, 20), {}, (0, 0)
    for (bus, ident), messages in by_source.items():
        values = [message.number("dc_voltage") for message in messages if condition(rule.tests, message)]
        numbers = [value for value in values if value is not None]
        mean, share = (found[name, f"can{bus}", ident] for name in names[:2])
        assert mean["seen"] == pytest.approx(sum(numbers) / len(numbers)), mean
        assert share["seen"] == pytest.approx(1 - len(numbers) / len(values)) and share["seen"] > 0, share
        row, away, last = [], [], messages[0].at
        for message in messages:
            row = [] if message.is_reboot or message.at - last > LATE or not condition(rule.tests, message) else row
            last, value = message.at, message.number("dc_voltage")
            if condition(rule.tests, message) and value is not None:
                row.append(value)
                away += [abs(row[-2] - (row[-3] + row[-1]) / 2)] if len(row) > 2 else []
        noise = found[names[3], f"can{bus}", ident]
        assert noise["seen"] == pytest.approx(sum(away) / len(away)) and len(away) > 3, noise
    for message, source in sorted(((one, source) for source, own in by_source.items() for one in own),
                                  key=lambda pair: pair[0].frame):
        latest[source] = message.at, message.number("dc_voltage") if condition(rule.tests, message) else None
        values = [value for at, value in latest.values() if value is not None and message.at - at <= LATE]
        if len(values) > 1:
            widest = max(widest, (max(values) - min(values), -message.frame))
    row = found[names[2], None, None]
    assert (row["ok"], row["frame"]) == (False, -widest[1]) and row["seen"] == pytest.approx(widest[0], rel=1e-5), row


def test_the_rules_of_the_page(folder):
    """The ten that most flights need: the flight of the documents breaks some, and each is judged."""
    table = (tshark.ROOT / "docs/rules.md").read_text().partition("| question | line |")[2].partition("\n\n")[0]
    rules = re.findall("`(.*?)`", table)
    (folder / "hover.rules").write_text("\n".join(rules))
    done = tshark.run("-q", "-r", tshark.ROOT / "docs/flight.pcapng", "-z", "yapp,check,rules=hover.rules", cwd=folder, check=False)
    assert done.returncode == 20 and "yapp:" not in done.stderr, done.stderr
    verdicts = dict(re.findall(r"^(FAILED|NOT JUDGED|ok) +(\S+)", done.stdout, re.M))
    assert len(rules) == 10 and verdicts.keys() == {"FAILED", "ok"}, done.stdout
    assert "motor.rpm_error" in done.stdout.partition("\nok")[2]


def test_a_condition_that_never_held(folder):
    """No verdict, and the line names it: of one source, of all, and of one that did not hold for long enough."""
    write(folder / "run.pcapng", random.Random(1))
    rules = ["motor.dc_voltage=..9", "motor.dc_voltage.mean=..9", "motor.dc_voltage.spread=9", "motor.dc_voltage.special=1"]
    for words in (" when=rpm_measured=60001..", " when=status.enabled after=999"):
        for row in check(folder / "run.pcapng", [rule + words for rule in rules], 21).values():
            assert row["rule"] == "unknown=0" or row["ok"] is None and row["note"].endswith(words), row
