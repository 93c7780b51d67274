# SPDX-License-Identifier: GPL-2.0-or-later
"""Flights: captures of buses with motor controllers and planted events, with their truth, from a seed.

    flight = flights.make(seed)
    flight.write(path, form)      "pcapng" (a named interface each bus), "sll2" (an index each bus), "candump" (a log)
    flight.arguments(form)        the preferences that go with it
    flights.make(seed, True)      one in which nothing went wrong
    flights.shared(seed)          one in which several controllers share sources: two on one bus, or the buses were merged
    flight.truth(form)            {"events": [...], "faults": [...], "summary": [...]}, as docs name the JSON lines
    flight.rows(form)             the good messages of known IDs: what CSV has

The truth is worked out from what was sent and what was planted, by the rules of the public names: nothing in it was ever
read from a capture.  What could be read in two ways is not planted: between two losses of a source an intact message comes.
"""
import collections
import dataclasses
import random
import struct

import capture_file
import model
from can_generator import END, MIDDLE, SINGLE, START, Frame, Sent, message_crc

SECOND = 1_000_000_000
EVERY = {message.name: message.every for message in model.MESSAGES.values() if message.every}  # a gap above LATE of them is a silence
LATE = 2.5  # the preference yapp.late
MAX_BEHIND = 8  # a Seq so far behind is of a message that came late
KIND = {message.name: ident for ident, message in model.MESSAGES.items()}
OTHERS = [name for name in KIND if name not in ("command", "motor", "health")]  # a message that the catalogue got later
# Columns of the summary that count events of a kind; a new one of a kind that is planted is a row here.
COUNTS = {"reboots": "reboot", "invalid": "invalid", "skipped": "skipped", "missing": "missing", "copies": "copies"}
FORMS = ["pcapng", "sll2", "candump"]
LATE_PCAPNG = "late pcapng"  # the interfaces but the first one behind what the plugin looks at when it opens a file


@dataclasses.dataclass
class Message:
    """A message as it was sent, and what became of it."""
    sender: "Sender"
    at: int  # ns since 1970
    seq: int
    payload: bytes
    fate: str = "good"      # or crc; Start, Middle, End: the frame that is not in the capture; overrun: some too many
    frames: list = dataclasses.field(default_factory=list)  # those that are in the capture, in order
    cut: bool = False       # the capture ended before the message did

    @property
    def is_good(self):
        return self.fate == "good" and not self.cut and bool(self.frames)


@dataclasses.dataclass(eq=False)
class Placed(Frame):
    at: int = 0
    number: int = 0


class Sender:
    """One ID on one bus."""

    def __init__(self, rng, bus, ident, kind, is_clean):
        self.rng, self.bus, self.ident, self.kind, self.is_clean = rng, bus, ident, kind, is_clean
        self.numbered = kind != "unknown" and rng.random() < 0.3
        self.seq = rng.randrange(256) if self.numbered else 0
        self.clock = rng.randrange(10**12)
        self.jumps = random.Random(f"jumps {self.clock}")  # of its own, so that the rest of a flight stays as it was
        self.faults, self.status, self.state = 0, 0x40010000, 1
        self.message = model.MESSAGES[KIND[kind]] if kind in KIND else None
        self.has_clock = self.message is not None and self.message.has_clock
        self.flags = {}  # of a message of OTHERS: by field
        self.messages = []

    def chance(self, probability):
        """Whether something happens that goes wrong."""
        return self.rng.random() < probability and not self.is_clean

    def payload(self):
        rng = self.rng
        if self.kind == "motor":
            counts = [rng.choice([65535, 65534, 65533, 65532, 65531]) if rng.random() < 0.01 else rng.randrange(30000, 36000)
                      for _ in range(6)]
            return struct.pack("<6HBBIIqBB", *counts, rng.randrange(60, 100), 2 if self.chance(0.01) else 1, self.status, self.faults, self.clock,
                               self.state, 255 if rng.random() < 0.02 else rng.randrange(60, 110)) + self.fields(13)
        if self.kind == "health":
            return struct.pack("<q", self.clock) + bytes(rng.randrange(20, 120) for _ in range(7)) + bytes([1, 4]) + self.fields(10)
        if self.kind == "command":
            key = rng.choice([0, 0x55, 0xFF]) if self.chance(0.04) else rng.choice([0xA5, 0x5A])
            return struct.pack("<BBBHH", 1, key, 1, rng.randrange(65000), rng.randrange(65000)) + self.fields(5)
        return self.fields(0) if self.message else rng.randbytes(20)

    def fields(self, first):
        """All from this one on: the table got them later."""
        return b"".join(self.count(*row).to_bytes(row[1], "little") for row in self.message[2][first:])

    def count(self, field, size, kind):
        """A field of any message."""
        rng, top = self.rng, 2 ** (8 * size) - 1
        if kind is None:
            return self.clock
        if model.is_float(kind):
            return top - rng.randrange(5) if rng.random() < 0.01 else rng.randrange(top // 3, top // 2)
        if model.is_flags(kind):
            if self.chance(0.05):
                self.flags[field] = self.flags.get(field, 0) ^ rng.choice(list(kind[1]))
            return self.flags.get(field, 0)
        return next(one for one in range(top) if one not in kind) if isinstance(kind, set) and self.chance(0.02) else \
            rng.choice(sorted(kind)) if isinstance(kind, set) else int.from_bytes(kind.make(rng, size), "little")

    def step_clock(self, elapsed, stands_still):
        """The controller's clock goes on, begins anew, jumps ahead, or stands still."""
        if self.chance(0.01):
            self.clock = min(self.clock - 1, self.rng.randrange(10**8))
        elif not stands_still:
            self.clock += elapsed + self.rng.randrange(-1000, 1000)
            if self.jumps.random() < 0.02 and not self.is_clean:
                self.clock += self.jumps.choice([SECOND // 2, SECOND - 10**7, SECOND + 10**7, self.jumps.randrange(3600 * SECOND)])

    def change_flags(self):
        rng = self.rng
        if self.chance(0.05):
            self.faults ^= rng.choice([*model.FAULT, 0x80000, 0x8000000])  # the last two stand in no table
        if rng.random() < 0.03:
            self.faults = 0
        if rng.random() < 0.05:
            self.status ^= rng.choice(list(model.STATUS))
        if self.chance(0.03):
            self.state ^= 0x20  # faulted, whatever the fault flags say

    def fly(self, begin, end):
        """All its messages from one time to another."""
        rng = self.rng
        period = int(EVERY.get(self.kind, 0.3) * SECOND) // (3 if self.kind == "command" else 1)
        time, before, clean, still = begin + rng.randrange(period), None, 3, 0
        stops = rng.randrange(begin, end) if self.chance(0.15) else end
        while time < min(end, stops):
            if before is not None:
                still = still - 1 if still else rng.randrange(1, 4) if self.chance(0.02) else 0
                self.step_clock(time - before, still > 0)
            self.change_flags()
            message = Message(self, time, self.seq, self.payload())
            self.plan(message, clean, time < end - SECOND)
            clean = clean + 1 if message.fate == "good" else 0
            self.messages.append(message)
            if self.numbered:
                self.seq = (self.seq + 1) % 256
            before = time
            time += period + rng.randrange(-period // 40, period // 40)
            if self.chance(0.02):
                time += period * rng.choice([1, 2, 4, 8])  # messages that were never sent
        return self

    def plan(self, message, clean, goes_on):
        """What happens to a message on its way.  goes_on: whether the capture does, for sure."""
        rng = self.rng
        sent = Sent(self.ident, 0, message.seq, message.payload)
        if len(message.payload) <= 8:
            frames = [sent.frame(SINGLE, message.payload)]
        else:
            frames = sent.frames()
        if clean >= 2 and self.message and len(frames) > 1 and self.chance(0.05):
            # Where messages are numbered, nothing tells that one whose End is lost will not go on.
            message.fate = rng.choice(["crc", "Start", "Middle"] + ["overrun"] * goes_on + ([] if self.numbered else ["End"]))
            if message.fate == "crc":
                wrong = message_crc(self.ident, 0, message.seq, message.payload) ^ 1 << rng.randrange(32)
                frames[0] = sent.start(crc=wrong)
            elif message.fate == "overrun":
                frames[-1:-1] = [sent.frame(MIDDLE, rng.randbytes(7) + bytes([255 - place])) for place in range(3)]
            else:
                lost = {"Start": START, "Middle": MIDDLE, "End": END}[message.fate]
                frames.remove(rng.choice([frame for frame in frames if frame.can_id >> 14 & 15 == lost]))
        at = message.at
        for frame in frames:
            message.frames.append(Placed(frame.can_id, frame.data, bus=self.bus, origin=message, at=at))
            at += rng.randrange(150_000, 500_000)


# The truth ---------------------------------------------------------------------------------------------------------

class Truth:
    """What follows from the messages of a flight, source by source."""

    def __init__(self, flight, form):
        self.flight, self.form = flight, form
        self.events, self.faults, self.summary = [], [], []
        self.missing_by_period = 0  # messages with faults that the gaps have room for, where Seq No does not number them
        for sender in flight.senders:
            if any(message.frames for message in sender.messages):
                self.source(sender)
        self.absent()
        self.faults.sort(key=lambda line: (line["event"] == "active", line["frame"]))
        self.events.sort(key=lambda line: (line["time"], line["frame"] or 1 << 40))

    def who(self, sender):
        kind = sender.kind if sender.kind != "unknown" else None
        return {"bus": self.flight.bus_name(sender.bus, self.form), "id": sender.ident,
                "source": self.flight.name(sender, self.form), "message": kind}

    def event(self, kind, sender, frame, **more):
        self.events.append({"kind": kind, "time": frame.at, "frame": frame.number, **self.who(sender), **more})

    def fault(self, sender, frame, flag, event, active):
        line = {"time": frame.at, "frame": frame.number, **self.who(sender), "field": flag[0], "flag": flag[1],
                "event": event, "active": active}
        self.faults.append(line)
        self.events.append({"kind": "fault", **line})

    def absent(self):
        """Sources that were named with a message and have no frame in the capture."""
        for bus, ident, kind, name in self.flight.named(self.form):
            if kind and not any(sender.ident == ident and self.flight.name(sender, self.form) == name and
                                bus in (None, self.flight.bus_name(sender.bus, self.form)) and
                                any(message.frames for message in sender.messages) for sender in self.flight.senders):
                self.events.append({"kind": "absent", "time": self.flight.frames[-1].at, "frame": None, "bus": bus,
                                    "id": ident, "source": name, "message": kind[:-1]})

    def source(self, sender):
        """One source: its messages in order, each with the good one before it."""
        lost = crc = 0
        good = []
        state = {"set": {}, "clock": None, "at": None, "seq": None}
        counts = collections.Counter()
        for index, message in enumerate(sender.messages):
            if not message.frames:
                continue
            if message.is_good:
                self.good(sender, message, good[-1] if good else None, state, counts)
                good.append(message)
            elif message.fate == "crc" and not message.cut:
                crc += 1
                self.event("crc", sender, message.frames[-1])
            else:
                lost += 1
                self.lost(sender, message, sender.messages[index + 1:])
        if good and sender.kind == "unknown":
            size = len(good[0].payload)
            self.event("unknown", sender, good[0].frames[-1], size=size, count=len(good), like=None)
        if good:
            for flag, since in state["set"].items():
                last = good[-1].frames[-1]
                self.fault(sender, last, flag, "active", last.at - since)
            self.silence(sender, good[-1], self.flight.frames[-1].at)
        if sender.message and sender.message.alarms and sender.message.every and good:
            if len({message.seq for message in good}) == 1:
                self.missing_by_period += fitting(gaps_by_clock(sender, good), sender)
            self.missing_by_period += fitting([self.flight.frames[-1].at - good[-1].frames[-1].at], sender)
        self.summary.append({**self.who(sender), "crc_bad": crc, "incomplete": lost, "late": counts["late"],
                             **rates(good), "values": ranges(sender, good),
                             **{column: self.count(sender, kind) for column, kind in COUNTS.items()}})

    def count(self, sender, kind):
        """How many messages of a source have events of a kind, or how many those are about."""
        who = self.who(sender)
        lines = [line for line in self.events if line["kind"] == kind and who.items() <= line.items()]
        return sum({line["frame"]: line.get("count", 1) for line in lines}.values())

    def good(self, sender, message, before, state, counts):
        last = message.frames[-1]
        if before and self.silence(sender, before, last.at):
            counts["late"] += 1
        for field, value in undefined(sender, message.payload):
            self.event("invalid", sender, last, field=field, value=value)
        is_reboot = False
        if sender.has_clock:
            is_reboot = self.clock(sender, message, state)
        missing = missing_before(message, state, is_reboot)
        if missing:
            self.event("missing", sender, last, count=missing)
        if sender.message:
            self.flags(sender, message, state)

    def clock(self, sender, message, state):
        """What the controller's clock says; returns whether it is a reboot."""
        clock, last = clock_of(sender, message.payload), message.frames[-1]
        before, jump = state["clock"], jump_of(clock, last.at, state)
        state["clock"], state["at"] = clock, last.at
        if jump:
            self.event("jump", sender, last, length=jump)
        if before is None or clock > before:
            return False
        kind = "reboot" if clock < before else "stale"
        self.event(kind, sender, last)
        return kind == "reboot"

    def flags(self, sender, message, state):
        now, last = model.alarms(KIND[sender.kind], message.payload), message.frames[-1]
        for flag in model.alarms(KIND[sender.kind]):
            if flag in now and flag not in state["set"]:
                state["set"][flag] = last.at
                self.fault(sender, last, flag, "raised", None)
            elif flag in state["set"] and flag not in now:
                self.fault(sender, last, flag, "cleared", last.at - state["set"].pop(flag))

    def silence(self, sender, before, until):
        """Whether a gap is one; it is told at the message before it."""
        last = before.frames[-1]
        every = EVERY.get(sender.kind)
        if not every or until - last.at <= round(LATE * every * SECOND):
            return False
        self.event("silence", sender, last, length=until - last.at)
        return True

    def lost(self, sender, message, later):
        """A message that is not whole: told where that shows."""
        frames = message.frames
        started = frames[0].can_id >> 14 & 15 == START
        ended = frames[-1].can_id >> 14 & 15 == END
        if not started:
            self.event("incomplete", sender, frames[0], what="orphan")
        elif ended:
            self.event("incomplete", sender, frames[-1], what="overrun" if message.fate == "overrun" else "incomplete")
        else:  # the next Start decides
            following = [one for one in later if one.frames]
            if following:
                self.event("incomplete", sender, following[0].frames[0], what="incomplete")
            else:
                self.event("unfinished", sender, frames[-1])


def undefined(sender, payload):
    """What the document does not define in a payload: (field, value)."""
    for field, _, kind, count in sender.message.counts(payload) if sender.message else ():
        if isinstance(kind, set) and count not in kind or model.is_flags(kind) and count & ~sum(kind[1]):
            yield field, count


def clock_of(sender, payload):
    count = next((count for _, _, kind, count in sender.message.counts(payload) if kind is None), 0)  # 0 without a clock
    return count - (count >> 63 << 64)


def jump_of(clock, at, state):
    """By how much the controller's clock advanced more than the capture's, if that is a jump."""
    if state["clock"] is None or clock <= state["clock"] or at < state["at"]:
        return None
    jump = clock - state["clock"] - (at - state["at"])
    return jump if jump > SECOND else None


def missing_before(message, state, is_reboot):
    """How many messages Seq says are missing before this one."""
    ahead = (message.seq - (message.seq if state["seq"] is None else state["seq"])) % 256
    if ahead >= 256 - MAX_BEHIND:
        return 0
    state["seq"] = message.seq
    return 0 if is_reboot else max(ahead - 1, 0)


def gaps_by_clock(sender, good):
    """By the controller's clock, unless that was set."""
    for before, after in zip(good, good[1:]):
        length = after.frames[-1].at - before.frames[-1].at
        advance = clock_of(sender, after.payload) - clock_of(sender, before.payload)
        has_room = length > 1.5 * sender.message.every * SECOND
        yield advance if has_room and 0 < advance <= length + SECOND else length


def fitting(gaps, sender):
    """How many messages fit into these: none into a gap of up to 1.5 periods."""
    periods = [gap / (sender.message.every * SECOND) for gap in gaps]
    return sum(int(gap - 0.5) for gap in periods if gap > 1.5)


def rates(good):
    times = [message.frames[-1].at for message in good]
    gaps = [(after - before, message.frames[-1].number)
            for before, after, message in zip(times, times[1:], good[1:])]
    span = times[-1] - times[0] if times else 0
    longest = max(gaps, key=lambda gap: gap[0]) if gaps else (None, None)
    return {"count": len(good), "rate": len(gaps) * SECOND / span if span else None,
            "gap_min": min(gaps)[0] if gaps else None, "gap_mean": span / len(gaps) if gaps else None,
            "gap_max": longest[0], "gap_max_frame": longest[1]}


def numbers(sender, payload):
    """The values that can be averaged: {field: value}; a reserved count has none."""
    return model.numbers(KIND[sender.kind], payload) if sender.message else {}


def ranges(sender, good):
    values = collections.defaultdict(list)
    for message in good:
        for field, value in numbers(sender, message.payload).items():
            values[field] += [value] if value is not None else []
    if not good and sender.kind != "unknown":
        values = {field: [] for field in numbers(sender, bytes(sender.message.size))}
    return {field: {"min": min(list_), "mean": sum(list_) / len(list_), "max": max(list_)} if list_ else
            {"min": None, "mean": None, "max": None} for field, list_ in values.items()}


# The flight --------------------------------------------------------------------------------------------------------

class Flight:
    def __init__(self, seed, is_clean=False, is_shared=False):
        self.is_clean = is_clean
        rng = self.rng = random.Random(f"flight {seed}")
        self.begin = 1_700_000_000 * SECOND + rng.randrange(10**12)
        self.end = self.begin + rng.randrange(4, 12) * SECOND
        self.names = rng.sample(["can0", "can1", "vcan_2", "left.can"], rng.choice([1, 2, 3]))
        self.senders = []
        for bus in range(len(self.names)):
            self.add_bus(bus)
        if is_shared:
            self.share(seed)
        self.choose_names()
        others = random.Random(f"others {seed}")  # of its own, so that the rest of a flight stays as it was
        for name in OTHERS:
            self.senders.append(Sender(others, others.randrange(len(self.names)), KIND[name], name, is_clean))
            self.by_bus[self.senders[-1].bus, KIND[name]] = (f"{name}:", name)
        self.collect()

    def add_bus(self, bus):
        rng = self.rng
        self.senders.append(Sender(rng, bus, KIND["command"], "command", self.is_clean))
        for place in rng.sample(range(4), rng.choice([1, 2, 3])):
            self.senders.append(Sender(rng, bus, KIND["motor"] + place, "motor", self.is_clean))
            if rng.random() < 0.7:
                self.senders.append(Sender(rng, bus, KIND["health"] + place, "health", self.is_clean))
        if rng.random() < 0.3 and not self.is_clean:
            self.senders.append(Sender(rng, bus, 0x320, "unknown", False))

    def share(self, seed):
        """All buses are one in the capture; or, where no ID is on two of them, others send what is sent there already."""
        rng = random.Random(f"flight {seed} shared")
        if seed % 2:
            self.names = self.names[:1]
            for sender in self.senders:
                sender.bus = 0
        clocked = [sender for sender in self.senders if sender.has_clock]
        if len({(sender.bus, sender.ident) for sender in clocked}) < len(clocked):
            return
        for sender in clocked[:1] + [one for one in clocked[1:] if rng.random() < 0.5]:
            for _ in range(rng.choice([1, 1, 2])):
                self.senders.append(Sender(rng, sender.bus, sender.ident, sender.kind, self.is_clean))

    def sources(self):
        """Each bus and ID: (one of its senders, all messages that have a frame, in order, whether several send there)."""
        by_source = collections.defaultdict(list)
        for sender in self.senders:
            by_source[sender.bus, sender.ident].append(sender)
        for senders in by_source.values():
            messages = [message for sender in senders for message in sender.messages if message.frames]
            yield senders[0], sorted(messages, key=lambda message: message.frames[-1].number), len(senders) > 1

    def choose_names(self):
        """The preference: some names for every bus, some for one."""
        rng, self.anywhere, self.by_bus = self.rng, {}, {}
        for sender in self.senders:
            kind = "" if sender.kind == "unknown" else sender.kind + ":"
            if rng.random() < 0.3:
                self.anywhere.setdefault(sender.ident, (kind, f"esc {sender.ident:x}"))
            elif rng.random() < 0.3:
                self.by_bus[sender.bus, sender.ident] = (kind, f"{sender.kind}_{sender.bus}_{sender.ident:x}")
        if rng.random() < 0.5 and not self.is_clean:  # some that never come
            self.anywhere[0x217] = ("motor:", "nowhere")
            self.by_bus[0, 0x207] = ("health:", "not here")

    def named(self, form):
        """What the user said: (bus or None, ID, "motor:" or so, name)."""
        return [(None, ident, *row) for ident, row in self.anywhere.items()] + \
            [(self.named_bus(bus, form), ident, *row) for (bus, ident), row in self.by_bus.items()]

    def collect(self):
        """All frames in the order of time, others' among them; cut at the end in the middle of a message, maybe."""
        rng = self.rng
        frames = []
        for sender in self.senders:
            for message in sender.fly(self.begin, self.end).messages:
                frames += message.frames
        for _ in range(sum(frame.origin.sender.kind not in OTHERS for frame in frames) // 10):
            frames.append(Placed(0x18FEF100 | rng.randrange(256), rng.randbytes(8), bus=rng.randrange(len(self.names)),
                                 at=rng.randrange(self.begin, self.end + (0 if self.is_clean else SECOND))))
        frames.sort(key=lambda frame: frame.at)
        if rng.random() < 0.5 and not self.is_clean:
            starts = [place for place, frame in enumerate(frames) if frame.origin and frame.can_id >> 14 & 15 == START]
            frames = frames[:rng.choice(starts[-8:]) + rng.randrange(1, 3)]
        self.frames, kept = frames, set(map(id, frames))
        for number, frame in enumerate(frames, 1):
            frame.number = number
        for sender in self.senders:
            for message in sender.messages:
                sent = len(message.frames)
                message.frames = [frame for frame in message.frames if id(frame) in kept]
                message.cut = len(message.frames) < sent

    def bus_name(self, bus, form):
        """The name of a bus: its interface's; one that stands for several has an index behind it.  The only one has none."""
        if form == "asc":
            return f"CAN-{bus + 1}"
        if form == "sll2":
            return f"if0#{bus + 1}" if len(self.names) > 1 else None
        return self.names[bus]

    def named_bus(self, bus, form):
        """The bus that a preference names: one that never comes where the capture names none."""
        return self.bus_name(bus, form) or self.names[bus]

    def name(self, sender, form):
        """What the user called a source."""
        row = self.anywhere.get(sender.ident)
        if self.bus_name(sender.bus, form):
            row = self.by_bus.get((sender.bus, sender.ident), row)
        return row and row[1]

    def arguments(self, form):
        parts = [f"{ident:#x}={kind}{name}" for ident, (kind, name) in self.anywhere.items()]
        parts += [f"{self.named_bus(bus, form)}/{ident:#x}={kind}{name}" for (bus, ident), (kind, name) in self.by_bus.items()]
        ids = {kind: ",".join(sorted({f"{sender.ident:#x}" for sender in self.senders if sender.kind == kind}))
               for kind in ("motor", "health")}
        return ["-o", f"yapp.sources:{', '.join(parts)}", "-o", f"yapp.motor_ids:0x210,{ids['motor']}", "-o",
                f"yapp.health_ids:0x200,{ids['health']}"]

    def truth(self, form):
        truth = Truth(self, form)
        return {"events": truth.events, "faults": truth.faults, "summary": truth.summary, "missing_by_period": truth.missing_by_period}

    def rows(self, form):
        """Of each known message the good ones in the order of the capture: (frame, bus, source, message)."""
        found = {name: [] for name in KIND}
        for sender in self.senders:
            for message in sender.messages:
                if message.is_good and sender.kind in found:
                    found[sender.kind].append((message.frames[-1], self.bus_name(sender.bus, form),
                                               self.name(sender, form), message))
        return {kind: sorted(rows, key=lambda row: row[0].number) for kind, rows in found.items()}

    def write(self, path, form):
        if form == "candump":
            path.write_text("".join(
                f"({frame.at // SECOND}.{frame.at % SECOND:09d}) {self.names[frame.bus]} "
                f"{frame.can_id:08X}#{frame.data.hex().upper()}\n" for frame in self.frames))
        else:
            path.write_bytes(self.pcapng(form))
        return path

    def pcapng(self, form):
        linktype, sll2 = (capture_file.SLL2, True) if form == "sll2" else (capture_file.SOCKETCAN, False)
        blocks = [capture_file.section()]
        for bus, name in enumerate([None] if sll2 else self.names):
            blocks.append(capture_file.interface(linktype, name, capture_file.NANOSECONDS))
            if form == LATE_PCAPNG and bus == 0:
                blocks.append(capture_file.LONG_BLOCK)
        for frame in self.frames:
            record = frame.record(little=sll2)
            record = capture_file.sll2(record, frame.bus + 1) if sll2 else record
            blocks.append(capture_file.packet(frame.at, record, 0 if sll2 else frame.bus))
        return b"".join(blocks)


def acf_can(*frames):
    """IEEE 1722: CAN frames in one Ethernet packet, ACF-CAN messages in NTSCF."""
    messages = b""
    for frame in frames:
        padding = -len(frame.data) % 4
        body = bytes([padding << 6 | 8, 1]) + bytes(8) + struct.pack(">I", frame.can_id) + frame.data + bytes(padding)
        messages += struct.pack(">H", 1 << 9 | (2 + len(body)) // 4) + body
    return bytes(12) + b"\x22\xf0" + struct.pack(">BBBB8x", 0x82, 0x80 | len(messages) >> 8, len(messages) & 0xFF, 0) + messages


def make(seed, is_clean=False):
    return Flight(seed, is_clean)


def shared(seed, is_clean=False):
    return Flight(seed, is_clean, True)
