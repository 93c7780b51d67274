# SPDX-License-Identifier: GPL-2.0-or-later
"""What the fields say of flights with planted events: all of it, in the right frames, and nothing else.

YAPP_FLIGHTS=100: more seeds.
"""
import bisect
import collections
import os
from decimal import Decimal

import pytest

import flights
import levels
import model
import published
import tshark

SEEDS = range(1, int(os.environ.get("YAPP_FLIGHTS", levels.size(3, 4))) + 1)
FLAGS = [f"taurus.{message.name}.{kind[0]}.{way}" for message in model.MESSAGES.values() for _, _, kind in message[2] if model.is_flags(kind)
         for way in ("raised", "cleared")]
ALARMED = [f"taurus.{message.name}.{message.fault_group}" for message in model.MESSAGES.values() if message.fault_group]
LINKS = [f"taurus.{message.name}.{message.answers}_in" for message in model.MESSAGES.values() if message.answers]
LINKS += [f"{group}.{way}_change" for group in ALARMED for way in ("previous", "next")]
TIMES = [f"{group}.active_time" for group in ALARMED]
TIMES += [f"taurus.{message.name}.clock_drift" for message in model.MESSAGES.values() if message.has_clock]
FORMULAS = [f"taurus.{message.name}.{name}" for message in model.MESSAGES.values() for name in message.generated]
# These are of every message, whole or not: looked at in the last frames of good ones.
COMMANDS = {message.answers for message in model.MESSAGES.values()}
OF_ANY = ["yapp.bus", "yapp.source", "yapp.time_delta", *FORMULAS]
# What an unreliable source has none of.
OF_HISTORY = model.CHANGE_EXPERTS + FLAGS + LINKS + TIMES + ["yapp.seq.missing"]
# The last two are not of one message alone.
NAMES = OF_HISTORY + OF_ANY + ["yapp.source.shared", "yapp.message.fault", "yapp.unfinished"]


class Truth:
    """{frame: {field: value}}, times in nanoseconds; by the rules of the public names, from what was sent."""

    def __init__(self, flight, form):
        self.flight, self.form, self.frames = flight, form, collections.defaultdict(dict)
        self.ends, self.fault_frames = set(), set()
        self.commands, self.shared = collections.defaultdict(list), {}  # shared: frame: messages of its source before it
        for sender, messages, is_shared in flight.sources():
            if sender.kind in COMMANDS:
                self.commands[sender.kind, sender.bus] = [one.frames[-1].number for one in messages if one.is_good]
            if is_shared and sender.has_clock:
                for index, message in enumerate(messages):
                    self.shared.update({frame.number: (sender, index) for frame in message.frames})
        for sender, messages, is_shared in flight.sources():
            if not sender.has_clock or not is_shared:
                self.source(sender, messages)

    def source(self, sender, messages):
        before, state = None, {"faults": {}, "changes": [], "clock": None, "at": None, "seq": None}
        for message in messages:
            if message.is_good:
                self.good(sender, message, before, state)
                before = message
        for number, following in zip(state["changes"], state["changes"][1:]):
            self.frames[number][self.group(sender) + ".next_change"] = following
        self.after_changes(messages, state["changes"])

    @staticmethod
    def group(sender):
        return f"taurus.{sender.kind}.{sender.message.fault_group}"

    def address(self, sender):
        """What a source without a name is called: its ID, and where the capture has several buses the bus before it."""
        return {f"{sender.ident:#x}", f"{self.flight.bus_name(sender.bus, self.form)} {sender.ident:#x}"}

    def after_changes(self, messages, changes):
        """The next change of messages that change nothing and have a fault."""
        for message in messages:
            number = message.frames[-1].number if message.is_good else 0
            if self.has_fault(message) and number and changes and number not in changes:
                at = bisect.bisect(changes, number)
                if at < len(changes):
                    self.frames[number][self.group(message.sender) + ".next_change"] = changes[at]

    def has_fault(self, message):
        return message.sender.message is not None and model.alarms(flights.KIND[message.sender.kind], message.payload) != []

    def faulty(self, message, frames):
        if self.has_fault(message):
            self.fault_frames.update(frame.number for frame in frames)

    def good(self, sender, message, before, state):
        last = message.frames[-1]
        shown = self.frames[last.number]
        self.ends.add(last.number)
        shown["yapp.bus"] = self.flight.bus_name(sender.bus, self.form)
        shown["yapp.source"] = self.flight.name(sender, self.form) or self.address(sender)
        self.faulty(message, message.frames)
        gap = last.at - before.frames[-1].at if before else None
        shown["yapp.time_delta"] = gap
        if gap and sender.kind in flights.EVERY:
            shown["yapp.late"] = gap > round(flights.LATE * flights.EVERY[sender.kind] * flights.SECOND)
        if sender.has_clock:
            self.clock(sender, message, state, shown)
        shown["yapp.seq.missing"] = flights.missing_before(message, state, shown.get("taurus.reboot")) or None
        if sender.message:
            self.values(message, before, state, shown)

    @staticmethod
    def clock(sender, message, state, shown):
        clock, at = flights.clock_of(sender, message.payload), message.frames[-1].at
        before = state["clock"]
        shown["taurus.jump"] = flights.jump_of(clock, at, state) is not None
        shown["taurus.reboot"], shown["taurus.stale"] = before is not None and clock < before, clock == before
        if before is None or clock < before:
            state["origin"] = clock, at
        state["clock"], state["at"] = clock, at
        shown[f"taurus.{sender.kind}.clock_drift"] = clock - state["origin"][0] - (at - state["origin"][1])

    def values(self, message, before, state, shown):
        last, sender, ident = message.frames[-1], message.sender, flights.KIND[message.sender.kind]
        counts = {field: count for field, _, _, count in sender.message.counts(before.payload)} if before else {}
        for field, _, kind, now in sender.message.counts(message.payload):
            if model.is_flags(kind):
                old = counts.get(field, now & ~kind.faults)  # in a first message faults are raised
                path = f"taurus.{sender.kind}.{kind[0]}"
                shown[f"{path}.raised"], shown[f"{path}.cleared"] = now & ~old, old & ~now
        if sender.message.alarms:
            self.faults(message, *({*model.alarms(ident, one.payload)} if one else set() for one in (message, before)), state, shown)
        if sender.message.answers:
            commands = self.commands[sender.message.answers, last.bus]
            at = bisect.bisect_left(commands, last.number)
            shown[f"taurus.{sender.kind}.{sender.message.answers}_in"] = commands[at - 1] if at else None
        shown.update(model.generated(ident, message.payload))

    def faults(self, message, now, old, state, shown):
        last, group = message.frames[-1], self.group(message.sender)
        state["faults"] = {flag: state["faults"].get(flag, last.at) for flag in now}
        shown["taurus.fault.raised"], shown["taurus.fault.cleared"] = now - old != set(), old - now != set()
        changes = state["changes"]
        if (now or now != old) and changes:
            shown[f"{group}.previous_change"] = changes[-1]
        if now:
            shown[f"{group}.active_time"] = last.at - min(state["faults"].values())
        if now != old:
            changes.append(last.number)


def nanoseconds(text):
    return int(Decimal(text).scaleb(9))


def value_of(name, text):
    if not text:
        return None
    if name in model.EVENT_EXPERTS:
        return True
    if name in TIMES or name == "yapp.time_delta":
        return nanoseconds(text)
    return text if name in ("yapp.bus", "yapp.source") else float(text) if name in FORMULAS else \
        tshark.truth(text) if name == "yapp.message.fault" else int(text, 0)


def is_right(name, found, wanted):
    if (found is None or wanted is None) and (name in TIMES or name in OF_ANY):
        return found is wanted  # a zero is shown
    if found is None or wanted is None or found is True:
        return (found or None) == (wanted or None)
    if name in TIMES:
        return abs(found - wanted) <= 2  # what is left of two doubles
    if isinstance(wanted, set):
        return found in wanted
    return abs(found - wanted) < 1e-5 * max(1, abs(wanted)) if name in FORMULAS else found == wanted


def frames_with(rows, name):
    return {number for number, row in enumerate(rows, 1) if row[NAMES.index(name)]}


def differences(truth, rows, passes, knows_all):
    """(frame, field, what is shown, what should be) of all but what other frames of a message say."""
    for number, row in enumerate(rows, 1):
        if number in truth.shared:
            continue
        for name, text in zip(NAMES[:-2], row):
            found, wanted = value_of(name, text), truth.frames[number].get(name)
            is_left_out = name in OF_ANY and number not in truth.ends or name.endswith("next_change") and (
                not passes or not knows_all and found is None)
            if not is_left_out and not is_right(name, found, wanted):
                yield number, name, found, wanted


@levels.each_once
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two passes"])
@pytest.mark.parametrize("seed", SEEDS)
def test_fields(folder, seed, passes):
    flight, form = flights.make(seed), flights.FORMS[seed % 3]
    capture = flight.write(folder / ("run.log" if form == "candump" else "run.pcapng"), form)
    rows, truth = tshark.fields(capture, NAMES, *flight.arguments(form), *passes), Truth(flight, form)
    # Else -2 tells buses apart on its second pass only.
    knows_all = form == "candump" or form == "pcapng" and len(flight.names) == 1
    assert list(differences(truth, rows, passes, knows_all))[:5] == []
    ends = {message.frames[-1].number for sender in flight.senders for message in sender.messages if message.frames}
    with_fault = truth.fault_frames if passes else truth.fault_frames & ends
    assert frames_with(rows, "yapp.message.fault") == with_fault
    planted = {line["frame"] for line in flight.truth(form)["events"] if line["kind"] == "unfinished"}
    unfinished = frames_with(rows, "yapp.unfinished")
    assert unfinished == (planted if passes else set()) or not knows_all and unfinished <= planted


@levels.without_tshark("of the tables of the tests alone")
def test_each_field_that_is_worked_out_is_compared():
    """Here; elsewhere stands what test_captures.py and test_experts.py compare."""
    here = {name for name in published.of("field").keys() - model.filters().keys()
            if name.startswith("taurus.") and name.rpartition(".")[2] not in ("rounded", "names", "undefined")}
    of_yapp = {"yapp.bus", "yapp.source", "yapp.time_delta", "yapp.seq.missing", "yapp.message.fault", "yapp.unfinished"}
    wanted = here | of_yapp | {*model.CHANGE_EXPERTS, "yapp.source.shared"}
    assert set(NAMES) == wanted, f"a field of a message is in MESSAGES of model.py, another one in NAMES: {set(NAMES) ^ wanted}"


def are_several(messages):
    """Whether more than one controller has sent enough to be sure of it."""
    counts = collections.Counter(message.sender for message in messages if message.is_good)
    return sum(count >= 6 for count in counts.values()) > 1


@levels.each_once
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two passes"])
@pytest.mark.parametrize("seed", SEEDS)
def test_shared_sources(folder, seed, passes):
    """Two controllers on one bus, or buses that were merged: it is said once for each source, soon, and then nothing that
    depends on what came before; all of the other sources."""
    flight, form = flights.shared(seed), flights.FORMS[seed % 3]
    capture = flight.write(folder / ("run.log" if form == "candump" else "run.pcapng"), form)
    rows, truth = tshark.fields(capture, NAMES, *flight.arguments(form), *passes), Truth(flight, form)
    knows_all = form == "candump" or form == "pcapng" and len(flight.names) == 1
    assert list(differences(truth, rows, passes, knows_all))[:5] == []
    said, is_unreliable = frames_with(rows, "yapp.source.shared"), set()
    places = [(truth.shared[number][0].bus, truth.shared[number][0].ident) for number in said]
    certain = {(sender.bus, sender.ident) for sender, messages, is_shared in flight.sources()
               if is_shared and sender.has_clock and are_several(messages)}
    if seed == SEEDS[0]:  # where nothing else is wanted, too
        alone = tshark.run("-r", capture, *flight.arguments(form), *passes, "-Y", "yapp.source.shared").stdout
        assert {int(line.split()[0]) for line in alone.splitlines()} == said
    assert certain and certain <= set(places) and len(set(places)) == len(places)
    assert max(truth.shared[number][1] for number in said) < 24  # some are lost
    count = 0
    for number, row in enumerate(rows, 1):
        sender = truth.shared.get(number, (None,))[0]
        if number in said:
            is_unreliable.add(sender)
        if sender in is_unreliable:
            assert [name for name in OF_HISTORY if row[NAMES.index(name)]] == [], number
            count += row[NAMES.index("yapp.source")] != ""
    assert count > 100


ALONE = model.CHANGE_EXPERTS + [name for name in FLAGS if name.startswith(tuple(ALARMED))] + LINKS + TIMES
ONE_EACH = list({name.rpartition(".")[2]: name for name in reversed(ALONE)}.values())


@levels.each_once
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two passes"])
@pytest.mark.parametrize("name", levels.few(ALONE, ONE_EACH))
def test_a_filter_alone(folder, name, passes):
    """Where nothing else is wanted of the tree, the history is asked for no more than that."""
    flight = flights.make(2)
    capture = flight.write(folder / "run.log", "candump")
    is_unknown = name.endswith("next_change") and not passes
    also = " || frame.number == 1" if is_unknown else ""
    found = tshark.run("-r", capture, *flight.arguments("candump"), *passes, "-Y", name + also).stdout
    wanted = [number for number, row in sorted(Truth(flight, "candump").frames.items())
              if not is_unknown and row.get(name) is not None and (row[name] or name in TIMES)]
    wanted = [1] if is_unknown else wanted
    assert wanted and [int(line.split()[0]) for line in found.splitlines()] == wanted
