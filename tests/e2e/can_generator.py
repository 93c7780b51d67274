# SPDX-License-Identifier: GPL-2.0-or-later
"""Random CAN captures of YAPP with their truth, from a seed.

    capture = can_generator.capture(seed, layout="interfaces", wide=False, situations=20, frames=50)
    capture.write(path)                 the file that tshark reads
    capture.verdicts                    what each frame is, by frame number
    can_generator.PREFERENCES           the message IDs that the captures use

The truth is a strict state machine for each bus that the file tells apart, written from the protocol's document and the rules of this project,
not from the plugin: tests/unit/can_oracle.lua.  A capture consists of situations, each with message IDs of its own, one
after the other or mixed.
"""
import dataclasses
import itertools
import pathlib
import random
import shutil
import struct
import subprocess

import capture_file
import model
from crc32k import crc32k

FD_LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]
SINGLE, START, MIDDLE, END = range(4)
SIZES = {message.name: message.size for message in model.MESSAGES.values()}

SLOTS = 64  # situations in one capture at most: each has one ID of each kind, and three unknown ones
FIRST_ID = {"command": 0x380, "motor": 0x300, "health": 0x340, "unknown": 0x400, "unknown 2": 0x500, "unknown 3": 0x600}
DEFAULT_ID = {"command": 0x000, "motor": 0x210, "health": 0x200}
PREFERENCES = [argument for kind, default in DEFAULT_ID.items() for argument in
               ("-o", f"yapp.{kind}_ids:{default:#x},{FIRST_ID[kind]:#x}-{FIRST_ID[kind] + SLOTS - 1:#x}")]
EVERY_EXTENDED = ["-o", "yapp.all_extended:TRUE"]


def message_crc(msg, ctl, seq, payload, reserved=0):
    """The CRC of a message: over the header that it would have on a UART, and its payload."""
    return crc32k(b"YP" + struct.pack("<BBIHH", seq, ctl, msg, len(payload), reserved) + payload)


def kind_of(msg):
    """The message of the catalogue that an ID carries in these captures, None for an unknown one."""
    for kind, default in DEFAULT_ID.items():
        if msg == default or FIRST_ID[kind] <= msg < FIRST_ID[kind] + SLOTS:
            return kind
    return None


# What is on the bus ------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Frame:
    """One CAN frame.  captured: bytes of the data that a snap length left, None for all."""
    can_id: int
    data: bytes
    fd: bool = False
    kind: str = "extended"  # or standard, remote, remote standard, error
    captured: int | None = None
    bus: int = 0
    origin: object = None  # the message that this frame was sent for

    @property
    def kept(self):
        return self.data if self.captured is None else self.data[:self.captured]

    def record(self, little=False):
        """The SocketCAN record: classic 16 bytes, CAN FD 72."""
        flag = {"extended": 0x80000000, "standard": 0, "remote": 0xC0000000, "remote standard": 0x40000000,
                "error": 0x20000000}[self.kind]
        header = struct.pack("<I" if little else ">I", self.can_id | flag) + struct.pack(
            "BB2x", len(self.data), 4 if self.fd else 0)
        return header + self.data.ljust(64 if self.fd else 8, b"\0")


@dataclasses.dataclass
class Sent:
    """A message as its sender means it."""
    msg: int
    ctl: int
    seq: int
    payload: bytes
    reserved: int = 0

    def id_for(self, ctrl):
        return self.msg << 18 | ctrl << 14 | self.ctl << 8 | self.seq

    def frame(self, ctrl, data, fd=False):
        return Frame(self.id_for(ctrl), data, fd, origin=self)

    def start(self, fd=False, crc=None, size=None):
        crc = message_crc(self.msg, self.ctl, self.seq, self.payload, self.reserved) if crc is None else crc
        size = len(self.payload) if size is None else size
        return self.frame(START, struct.pack("<IHH", crc, size, self.reserved), fd)

    def frames(self, fd=False, chunk=8):
        """All frames of the message, in order."""
        chunks = [self.payload[at:at + chunk] for at in range(0, len(self.payload), chunk)]
        last = chunks.pop()
        if fd:
            last = padded(last)
        return [self.start(fd), *(self.frame(MIDDLE, data, fd) for data in chunks), self.frame(END, last, fd)]


def padded(data):
    """CAN FD: zeros up to the next length that exists."""
    return data.ljust(next(length for length in FD_LENGTHS if length >= len(data)), b"\0")


# The truth ---------------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Verdict:
    """What a frame is.  Frames that are not YAPP's have ours == False and nothing else."""
    ours: bool = False
    ctrl: int = 0
    experts: set = dataclasses.field(default_factory=set)
    status: int | None = None     # of the CRC, on the last frame of a message that has all its bytes
    payload: bytes | None = None  # of a message that is whole: a single frame, or all bytes there
    members: list = dataclasses.field(default_factory=list)  # numbers of all frames of such a message
    reassembled_in: int | None = None
    padding: int = 0
    unsure: bool = False  # whether the search among its frames may be too long


ROOT = pathlib.Path(__file__).resolve().parents[2]
LUA = next((lua for lua in ("lua5.4", "lua5.2") if shutil.which(lua)), None)
KNOWN = {msg: SIZES[kind] for kind, default in DEFAULT_ID.items()
         for msg in (default, *range(FIRST_ID[kind], FIRST_ID[kind] + SLOTS))}


def line_of(frame, accepts_all, is_merged):
    """A frame for the oracle."""
    can_id = frame.can_id if frame.kind == "extended" and frame.data else "-"
    return f"{0 if is_merged else frame.bus} {can_id} {int(accepts_all)} {len(frame.data)} x{frame.kept.hex()}\n"


def verdicts(frames, accepts_all, is_merged=False):
    """What each frame is, by its number, as the oracle says; is_merged: nothing tells the buses apart."""
    known = " ".join(f"{msg}={size}" for msg, size in KNOWN.items())
    asked = known + "\n" + "".join(line_of(frame, accepts_all, is_merged) for frame in frames)
    said = subprocess.run([LUA, ROOT / "tests/unit/can_verdicts.lua", ROOT], input=asked, capture_output=True, text=True,
                          check=True).stdout.splitlines()
    assert len(said) == len(frames)
    return {number: verdict_of(number, frames, line.split("\t")) for number, line in enumerate(said, 1)}


def verdict_of(number, frames, said):
    what, anomalies, in_number, members, padding, is_unsure = said
    frame = frames[number - 1]
    ctrl, kind = frame.can_id >> 14 & 15, kind_of(frame.can_id >> 18)
    verdict = Verdict(unsure=is_unsure == "1")
    if what == "-":
        return verdict
    verdict.ours, verdict.ctrl = True, ctrl
    verdict.experts = set() if anomalies == "-" else set(anomalies.split(","))
    if len(frame.kept) < len(frame.data):
        verdict.experts.add("truncated")
    verdict.padding = 0 if padding == "-" else int(float(padding))
    if what == "single":
        fits = padding != "-"
        verdict.payload = frame.data[:SIZES[kind]] if fits else frame.data
        size_is_wrong = not fits
    elif members == "-":
        return verdict
    else:
        verdict.members = [int(float(member)) for member in members.split(",")]
        sent = [frames[member - 1] for member in verdict.members]
        size = struct.unpack("<H", sent[0].data[4:6])[0]
        verdict.payload = b"".join(one.data for one in sent[1:])[:size]
        verdict.status = {"bad": 0, "good": 1, "truncated": 2}[what]
        if what == "bad":
            verdict.experts.add("crc.bad")
        size_is_wrong = size != SIZES.get(kind)
    if kind is None:
        verdict.experts.add("id.unknown")
    elif size_is_wrong:
        verdict.experts.add("size.mismatch")
    return verdict


def with_links(found):
    """Adds to each frame of a message which frame shows it."""
    for number, verdict in found.items():
        for member in verdict.members:
            found[member].reassembled_in = number
    return found


# Senders and what can go wrong -------------------------------------------------------------------------------------

def motor_payload(rng, count):
    """Motor Data; the time makes each payload a different one."""
    return struct.pack("<6HBBIIqBB", *(rng.randrange(65536) for _ in range(6)), rng.randrange(256), rng.randrange(2),
                       rng.choice([0x40010000, rng.getrandbits(32)]), rng.choice([0, 0, rng.getrandbits(32)]),
                       count * 100_000_007 - 5, rng.randrange(64), rng.randrange(256))


def health_payload(rng, count):
    return struct.pack("<q", count * 500_000_003 - 5) + rng.randbytes(9)


def command_payload(rng, _):
    return struct.pack("<BBBHH", rng.randrange(2), rng.choice([0xA5, 0x5A, 0]), rng.randrange(2),
                       rng.randrange(65536), rng.randrange(65536))


class Sender:
    """One message of one ESC: an ID, with Seq in use or not."""

    def __init__(self, rng, msg, fd, style):
        self.rng, self.msg, self.kind, self.fd, self.style = rng, msg, kind_of(msg), fd, style
        self.numbered = rng.random() < 0.4
        self.seq = rng.randrange(256) if self.numbered or rng.random() < 0.2 else 0
        self.ctl = rng.randrange(64) if style.wide and rng.random() < 0.15 else 0
        self.chunk = rng.choice(FD_LENGTHS[8:]) if fd else 8

    def message(self):
        rng = self.rng
        serial = next(self.style.serial)
        if self.kind:
            payload = {"command": command_payload, "motor": motor_payload, "health": health_payload}[self.kind](rng, serial)
            payload += rng.randbytes(SIZES[self.kind] - len(payload))  # fields that the table got later
        else:
            length = rng.choice([9, 12, 15, 16, 17, 32, 40] if self.style.short else
                                [9, 12, 16, 17, 32, 40, 64, 65, 100, rng.randrange(9, 400)])
            payload = struct.pack("<I", serial) + rng.randbytes(length - 4)
        if rng.random() < 0.2:  # an idle motor has many zeros; the serial number stays
            if self.kind == "motor":
                payload = bytes(16) + payload[16:]
            elif not self.kind:
                payload = payload[:rng.randrange(8, len(payload))].ljust(len(payload), b"\0")
        if self.style.wide and rng.random() < 0.05:  # another size than the catalogue's, or than a Start needs
            payload = rng.randbytes(rng.choice([1, 5, 8, 9, 33]))
        if self.numbered:
            self.seq = (self.seq + 1) % 256
        return Sent(self.msg, self.ctl, self.seq, payload, rng.getrandbits(16) if rng.random() < 0.02 else 0)

    def frames(self):
        """The frames of the next message, as they come over a bad bus."""
        rng, sent = self.rng, self.message()
        if len(sent.payload) <= 8 and rng.random() < 0.8 or self.fd and len(sent.payload) <= 64 and rng.random() < 0.3:
            frames = [sent.frame(SINGLE, padded(sent.payload) if self.fd else sent.payload, self.fd)]
        else:
            frames = sent.frames(self.fd, self.chunk)
        if rng.random() < self.style.fault_rate:
            rng.choice(FAULTS)(rng, frames)
        if rng.random() < self.style.snap_rate:
            cut = rng.choice(frames) if frames else None
            if cut and cut.data:
                cut.captured = rng.randrange(len(cut.data))
        return frames


def _another(frame, data=None, ctrl=None):
    can_id = frame.can_id if ctrl is None else frame.can_id & ~(15 << 14) | ctrl << 14
    return dataclasses.replace(frame, can_id=can_id, data=frame.data if data is None else data)


def lost(rng, frames):
    del frames[rng.randrange(len(frames))]


def lost_tail(rng, frames):
    del frames[rng.randrange(len(frames)):]


def lost_head(rng, frames):
    del frames[:rng.randrange(len(frames)) + 1]


def repeated(rng, frames):
    at = rng.randrange(len(frames))
    frames.insert(at, _another(frames[at]))


def repeated_start(_, frames):
    frames.insert(0, _another(frames[0]))


def repeated_end(_, frames):
    frames.append(_another(frames[-1]))


def restarted(rng, frames):
    """The sender gives up in the middle and begins again."""
    frames[:0] = [_another(frame) for frame in frames[:rng.randrange(1, len(frames) + 1)]]


def swapped(rng, frames):
    at = rng.randrange(len(frames))
    frames.insert(rng.randrange(len(frames)), frames.pop(at))


def flipped(rng, frames):
    at = rng.randrange(len(frames))
    data = bytearray(frames[at].data)
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    frames[at] = _another(frames[at], bytes(data))


def shortened(rng, frames):
    at = rng.randrange(len(frames))
    shorter = [length for length in FD_LENGTHS if length < len(frames[at].data)]
    frames[at] = _another(frames[at], frames[at].data[:rng.choice(shorter)])


def lengthened(rng, frames):
    at = rng.randrange(len(frames))
    top = 64 if frames[at].fd else 8
    longer = [length for length in FD_LENGTHS if len(frames[at].data) < length <= top]
    if longer:
        frames[at] = _another(frames[at], frames[at].data + rng.choice([bytes, rng.randbytes])(
            rng.choice(longer) - len(frames[at].data)))


def too_many(rng, frames):
    """Frames more than the size says."""
    at = rng.randrange(len(frames))
    extra = [_another(frames[-1], rng.randbytes(rng.choice([1, 8])), MIDDLE) for _ in range(rng.randrange(1, 5))]
    frames[at + 1:at + 1] = extra


def another_control(rng, frames):
    at = rng.randrange(len(frames))
    frames[at] = _another(frames[at], None, rng.randrange(16))


def another_size(rng, frames):
    if len(frames[0].data) == 8:
        frames[0] = _another(frames[0], frames[0].data[:4] + struct.pack(
            "<H", rng.choice([0, 1, 8, 9, 31, 33, 65535])) + frames[0].data[6:])


def wrong_crc(rng, frames):
    frames[0] = _another(frames[0], rng.randbytes(4) + frames[0].data[4:])


FAULTS = [lost, lost, lost_tail, lost_head, repeated, repeated_start, repeated_end, restarted, swapped, flipped,
          flipped, shortened, lengthened, too_many, another_control, another_size, wrong_crc]


def foreign_frame(rng, ids):
    """A frame of somebody else's; a random extended one may be YAPP's all the same: the truth decides.  Remote frames
    ask for anything, also for the IDs that are in use."""
    data = rng.randbytes(rng.randrange(9))
    kind = rng.choice(["standard", "extended", "extended", "remote", "remote standard", "error"])
    if kind == "remote":  # as the kernel records it: the length asked for, no data
        can_id = rng.choice([rng.getrandbits(29), rng.choice(ids) << 18 | rng.randrange(4) << 14])
        return Frame(can_id, bytes(len(data)), kind=kind)
    if kind == "remote standard":
        return Frame(rng.getrandbits(11), bytes(len(data)), kind=kind)
    if kind == "error":
        return Frame(rng.getrandbits(9), bytes(8), kind=kind)
    return Frame(rng.getrandbits(11 if kind == "standard" else 29), data, kind=kind)


# Captures ----------------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Style:
    """What a situation is like."""
    wide: bool
    short: bool
    fault_rate: float
    snap_rate: float
    foreign_rate: float
    serial: object  # counts messages, so that no payload is there twice


def _bus(rng, senders, style, count):
    """Frames of one bus: the messages of its ESCs interleave, each ESC sends its own in order."""
    waiting, frames = [[] for _ in senders], []
    while len(frames) < count:
        if rng.random() < style.foreign_rate:
            frames.append(foreign_frame(rng, [sender.msg for sender in senders]))
        at = rng.randrange(len(senders))
        if not waiting[at]:
            waiting[at] = senders[at].frames()
            if rng.random() < 0.3:  # in one burst
                frames += waiting[at]
                waiting[at] = []
        elif waiting[at]:
            frames.append(waiting[at].pop(0))
    return frames


def merge(rng, streams):
    """Several streams as one, each in its own order."""
    order = [i for i, stream in enumerate(streams) for _ in stream]
    rng.shuffle(order)
    iterators = [iter(stream) for stream in streams]
    return [next(iterators[i]) for i in order]


def _situation(rng, serial, slot, layout, wide, count):
    fd = rng.random() < 0.35
    faultless = layout in MERGED and rng.random() < 0.5
    style = Style(wide, layout in MERGED, 0 if faultless else rng.choice([0, 0.1, 0.3, 0.6]),
                  0 if faultless else rng.choice([0, 0, 0, 0.2]),
                  rng.choice([0, 0.1]), serial)
    kinds = rng.sample(list(FIRST_ID), rng.randrange(1, 6))
    ids = [FIRST_ID[kind] + slot if slot or kind not in DEFAULT_ID else DEFAULT_ID[kind] for kind in kinds]
    buses = []
    for bus in range(1 if layout in ONE_BUS else 2):
        senders = [Sender(rng, msg, fd, style) for msg in ids]
        frames = _bus(rng, senders, style, count)
        for frame in frames:
            frame.bus = bus
        buses.append(frames)
    return merge(rng, buses)


LAYOUTS = ["plain", "one interface", "interfaces", "sll2", "merged", "merged interface"]
ONE_BUS = {"plain", "one interface"}
SEVERAL_BUSES = {"interfaces", "sll2"}
MERGED = {"merged", "merged interface"}
LINKTYPES = {"sll": capture_file.SLL, "sll2": capture_file.SLL2}
INTERFACES = {"interfaces": 2, "one interface": 1, "merged interface": 1}


class Capture:
    """Frames, what they are, and the file they are written to."""

    def __init__(self, frames, layout, wide):
        self.frames, self.layout, self.wide = frames, layout, wide
        self.verdicts = with_links(verdicts(frames, wide, layout in MERGED))

    def without_remote_frames(self):
        """The same capture where nothing tells remote frames from data: a first pass of two knows neither fields nor
        columns."""
        return Capture([frame for frame in self.frames if frame.kind != "remote"], self.layout, self.wide)

    @property
    def preferences(self):
        return PREFERENCES + (EVERY_EXTENDED if self.wide else [])

    def write(self, path):
        write(path, self.frames, self.layout)


def capture(seed, layout, wide=False, situations=1, frames=50):
    """A random capture: so many situations, of about so many frames each."""
    rng, serial = random.Random(f"{seed} {layout} {wide}"), itertools.count(1)
    count = frames // (1 if layout in ONE_BUS else 2)
    parts = [_situation(rng, serial, slot, layout, wide, count) for slot in range(situations)]
    while len(parts) > 1 and rng.random() < 0.7:  # some at the same time, the others one after the other
        parts[:2] = [merge(rng, parts[:2])]
        rng.shuffle(parts)
    return Capture([frame for part in parts for frame in part], layout, wide)


# Files -------------------------------------------------------------------------------------------------------------

def write(path, frames, layout):
    """Writes frames as pcap or pcapng; the layout says how the file tells its buses, if it does."""
    packets = []
    for number, frame in enumerate(frames, 1):
        record = frame.record(little=layout in LINKTYPES)
        record = capture_file.sll2(record, frame.bus + 3, frame.fd) if layout == "sll2" else \
            capture_file.sll(record, frame.fd) if layout == "sll" else record
        packets.append((number * 1000, record, None if frame.captured is None else
                        len(record) - (64 if frame.fd else 8) + frame.captured))
    if layout not in INTERFACES:
        data = capture_file.pcap(LINKTYPES.get(layout, capture_file.SOCKETCAN), packets)
    else:
        data = capture_file.section(*[capture_file.interface(capture_file.SOCKETCAN)] * INTERFACES[layout])
        data += capture_file.LONG_BLOCK * (layout == "merged interface")
        data += b"".join(capture_file.packet(at, record, frame.bus * (layout == "interfaces"), captured)
                         for frame, (at, record, captured) in zip(frames, packets))
    pathlib.Path(path).write_bytes(data)


def write_behind_ip(path, count, frames):
    """Writes frames as Linux cooked v2, behind so many packets of IP."""
    ip = struct.pack(">HHIHBB8x", 0x0800, 0, 2, 1, 0, 6) + bytes(20)
    records = [ip] * count + [capture_file.sll2(frame.record(little=True), frame.bus + 3, frame.fd) for frame in frames]
    path.write_bytes(capture_file.pcap(capture_file.SLL2, ((number * 1000, record) for number, record in enumerate(records))))
