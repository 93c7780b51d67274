# SPDX-License-Identifier: GPL-2.0-or-later
"""Serial streams over every transport, against their truth, in one pass and in two.

    python3 -m pytest tests/e2e/test_streams.py                                some random streams; more with YAPP_LEVEL=all
    YAPP_SOAK_STREAMS=1000 python3 -m pytest -s tests/e2e/test_streams.py      a thousand

YAPP_SEED chooses other ones.  A failure says which transport, seed and packet.
"""
import collections
import functools
import os
import re
import shutil
import struct

import pytest

import levels
import model
import stream_captures
import tshark
from expected import plain
from stream_captures import ETHERNET, EXPORTED_PDU, Event, Packet, Origin, frame, header

STREAMS = int(os.environ.get("YAPP_SOAK_STREAMS", levels.size("110", "330")))
SEED = os.environ.get("YAPP_SEED", "1")
TRANSPORTS = list(stream_captures.TRANSPORTS)
PER_FILE = levels.size(5, 15)
FILES = -(-STREAMS // PER_FILE)

INFO = "_ws.col.Info" if tshark.version() < (4, 2) else "_ws.col.info"
EXPERTS = ["crc.bad", "id.unknown", "stream.skipped", "fragment.incomplete", "truncated", "size.mismatch",
           "reserved.nonzero"]
TAURUS = [name for name in model.filters() if name.count(".") > 1]  # the values
FIELDS = ["frame.number", INFO, "_ws.lua.error", "yapp", *(f"yapp.{name}" for name in [
    "id", "seq", "ctl", "size", "sync", "crc", "crc.status", "payload", "undecoded", "skipped", "fragment.data", "fragment",
    "fragment.count", "reassembled.in", "reassembled.length", "reassembled.data", "time_delta", *EXPERTS]), *TAURUS]
LABELS = {"good": "CRC good", "bad": "CRC BAD", "incomplete": "incomplete"}
ENDS = {"good": "", "bad": "", "incomplete": "  [INCOMPLETE]"}
PASSES = {"one pass": [], "-2": ["-2"], "-2 -Y": ["-2", "-Y", "yapp"]}
SOME_PASSES = list(PASSES.values())[:levels.size(2, 3)]


def shown(path, *arguments, also=()):
    """What tshark shows of each packet, by number: {field: [values]}, without the fields that are not there."""
    names = [*FIELDS, *also]
    wanted = [argument for name in names for argument in ("-e", name)]
    done = tshark.run(*arguments, "-r", path, "-T", "fields", "-E", "occurrence=a", "-E", "aggregator=;", *wanted)
    packets = {}
    for line in done.stdout.splitlines():
        values = dict(zip(names, line.split("\t")))
        packet = {name: [plain(name, one) for one in value.split(";")] for name, value in values.items() if value}
        packet["info"] = values[INFO] if tshark.version() < (4, 2) else values[INFO].replace(r"\\", "\\")
        packets[int(values["frame.number"])] = packet
    assert packets or "-Y" in arguments, f"tshark read no packet of {path}"
    return packets


# What a packet has to show ---------------------------------------------------------------------------------------

def quoted(data):
    """The first bytes as the Info column quotes them, as in a hex dump."""
    return "".join(chr(one) if 32 <= one < 127 else "." for one in data[:80])


def counted(data):
    return "1 byte" if len(data) == 1 else f"{len(data)} bytes"


def fits(event):
    """Whether the header says a size that the catalogue has for its ID."""
    size = int.from_bytes(event.data[8:10], "little")
    return event.ident in stream_captures.KNOWN and stream_captures.LEAST[event.ident] <= size <= stream_captures.KNOWN[event.ident]


def is_longer(event):
    """A good message with more bytes than the catalogue has: it is decoded, and what follows is bytes."""
    return event.kind == "good" and len(event.payload) > stream_captures.KNOWN.get(event.ident, 65535)


def faults(event):
    """What Info begins with: of each field the faults by name, and the bits without one."""
    texts, found = [], model.alarms(event.ident, event.payload)
    for field in model.MESSAGES[event.ident].alarms:
        names = [flag for one, flag in found if one == field]
        undefined = sum(int(flag.removeprefix("undefined_"), 16) for flag in names if flag.startswith("undefined_"))
        texts += [flag for flag in names if not flag.startswith("undefined_")] + [f"undefined {undefined:#x}"] * bool(undefined)
    return f"FAULT {', '.join(texts)}  " if texts else ""


def info(packet, event):
    if event.kind == "skipped":
        return f'Skipped {counted(event.data)} "{quoted(event.data)}"'
    bus = packet.bus
    source = f" ({bus})" if bus else ""
    damage = "BAD CRC  " * (event.kind == "bad")
    known = model.MESSAGES.get(event.ident)
    if known:
        name = f"{known[1]} 0x{event.ident:x}{source}" if bus else known[1]
        if event.kind == "good" and (fits(event) or is_longer(event)):
            name = faults(event) + name
        return damage + (name if fits(event) or is_longer(event) else f"{name}, {counted(event.payload)}, the catalogue says")
    is_truncated = event.kind == "incomplete" and event is packet.events[-1] and packet.captured < len(packet.data)
    size = counted(event.payload)
    if event.kind == "incomplete" and not is_truncated:
        size = f"{len(event.payload)} of {int.from_bytes(event.data[8:10], 'little')} bytes"
    return f"{damage}ID 0x{event.ident:x}{source}  {size}{'  [TRUNCATED]' if is_truncated else ENDS[event.kind]}"


def label(event):
    return f"{counted(event.data)} skipped" if event.kind == "skipped" else LABELS[event.kind]


def expected(packet):
    """The fields of a packet, but for links."""
    fields = collections.defaultdict(list)

    def add(**values):
        for name, value in values.items():
            fields["yapp." + name.replace("__", ".")].append(value)

    for event in packet.events:
        if event.kind == "skipped":
            add(skipped=event.data.hex(), stream__skipped="")
            continue
        payload = event.payload
        add(id=f"0x{event.ident:08x}", seq=str(event.data[2]), ctl=str(event.data[3]), sync="0x5950",
            size=str(int.from_bytes(event.data[8:10], "little")))
        if event.kind == "incomplete":
            add(**{"truncated" if packet.captured < len(packet.data) else "fragment__incomplete": ""})
        else:
            add(crc=f"0x{event.sent_crc:08x}", crc__status=str(int(event.kind == "good")))
            if event.ident in model.MESSAGES and (fits(event) or is_longer(event)):
                for name, value in model.decode(event.ident, payload)[0].items():
                    fields[name].extend(value.split(";") if name in TAURUS else [])
        if event.kind == "bad":
            add(crc__bad="")
        if any(event.data[10:12]):
            add(reserved__nonzero="")
        if event.ident not in model.MESSAGES:
            is_lost = event.kind == "incomplete" and packet.captured == len(packet.data)
            add(**{} if is_lost else {"id__unknown": ""})
        elif not fits(event):
            add(size__mismatch="")
        is_lost = event.kind == "incomplete" and packet.captured == len(packet.data)
        if is_longer(event):
            add(undecoded=payload[stream_captures.KNOWN[event.ident]:].hex())
        elif payload and (event.ident not in model.MESSAGES or not fits(event) or is_lost):
            add(payload=payload.hex())
        if event.delta is not None:
            add(time_delta=model.time_text(event.delta))
    is_ours, is_incomplete = packet.events or packet.pending, any(event.kind == "incomplete" for event in packet.events)
    if is_ours and packet.captured < len(packet.data) and not is_incomplete:
        add(truncated="")
    if packet.pending:
        add(fragment__data=packet.pending.hex())
    return fields


class Comparison:
    """What tshark shows of a packet, held against the truth."""

    def __init__(self, packet, row, later_known):
        self.packet, self.row, self.later_known, self.problems = packet, row, later_known, []

    def expect(self, what, wanted, is_shown):
        if wanted != is_shown:
            self.problems.append(f"packet {self.packet.number}: {what}: expected {wanted}, shown {is_shown}")

    def run(self):
        self.trees()
        self.fields()
        self.links()
        self.info()
        return self.problems

    def trees(self):
        """One for each message."""
        wanted = [label(event) for event in self.packet.events] + ["part of a frame"] * bool(self.packet.pending)
        trees = self.row.get("yapp", [])
        self.expect("trees", len(wanted), len(trees))
        for text, tree in zip(wanted, trees):
            self.expect("tree", text, tree.split(", ")[-1])

    def fields(self):
        wanted = expected(self.packet)
        for name in FIELDS[4:]:
            expert = name.removeprefix("yapp.") in EXPERTS
            if name in ("yapp.fragment", "yapp.fragment.count") or name.startswith("yapp.reassembled."):
                continue
            if name in TAURUS and any(event.kind == "incomplete" for event in self.packet.events):
                continue
            values = self.row.get(name, [])
            self.expect(name, len(wanted[name]) if expert else wanted[name], len(values) if expert else values)

    def links(self):
        """To the packets of a frame, and from them to the last one."""
        packet, row = self.packet, self.row
        joined = [event for event in packet.events if set(event.parts) - {packet}]
        wanted = {"yapp.fragment": [str(one.number) for event in joined for one in event.parts],
                  "yapp.fragment.count": [str(len(event.parts)) for event in joined],
                  "yapp.reassembled.length": [str(len(event.data)) for event in joined],
                  "yapp.reassembled.data": [event.payload.hex() for event in joined if event.payload]}
        for name, values in wanted.items():
            self.expect(name, values, row.get(name, []))
        links = row.get("yapp.reassembled.in", [])
        self.expect("links to this packet", [str(packet.number)] * len(joined), links[:len(joined)])
        later = {str(one.number) for one in packet.leads_to} if packet.pending and self.later_known else set()
        self.expect("links to other packets", set(), set(links[len(joined):]) - later)
        self.expect("a link to a later packet", bool(later), len(links) > len(joined))

    def info(self):
        texts = [info(self.packet, event) for event in self.packet.events]
        parts = re.sub(r"^(\[TCP [^]]*\] ?)*", "", self.row.get("info", "")).split(" | ")
        if self.packet.pending:
            last = parts.pop()
            self.expect("Info on what waits", True, "wait for more" in last or "[Reassembled in #" in last)
        if self.packet.events:
            self.expect("parts of Info", len(texts), len(parts))
            for text, part in zip(texts, parts):
                part = re.sub(r"cleared [\w, ]+?  ", "", part)  # by the message before: test_flight_fields.py
                self.expect("Info", text, part[:len(text)])


def later_known(capture, passes):
    """Whether links to later packets are: the file tells the sources apart in every pass."""
    return passes != "one pass"


def compare(capture, path, passes):
    """The differences between the packets of a capture and what tshark shows of them."""
    rows = shown(path, *PASSES[passes], *capture.options)
    problems = []
    for packet in capture.packets:
        row = rows.pop(packet.number, {})
        assert "_ws.lua.error" not in row, f"packet {packet.number}: {row}"
        problems += Comparison(packet, row, later_known(capture, passes)).run()
    return problems + [f"packet {number} is not known" for number in rows]


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("passes", PASSES)
@pytest.mark.parametrize("number", range(FILES))
def test_random_streams(number, passes, folder):
    transport, seed = TRANSPORTS[number % len(TRANSPORTS)], f"{SEED}.{number}"
    capture = stream_captures.capture(transport, seed, PER_FILE)
    capture.write(folder / "streams.pcapng")
    problems = compare(capture, folder / "streams.pcapng", passes)
    assert not problems, f"{transport}, seed {seed}, {passes}: {len(problems)}\n" + "\n".join(problems[:20])


# Single situations -----------------------------------------------------------------------------------------------

ONE, TWO, THREE = (frame(0x301 + number, bytes([number]) * 30, seq=number) for number in range(3))
BAD = ONE[:-1] + bytes([ONE[-1] ^ 1])
MOTOR = frame(0x210, bytes(range(32)))
LOST_BYTE, DAMAGED = MOTOR[:30] + MOTOR[31:], MOTOR[:30] + b"?" + MOTOR[31:]
GROWN, SHORT, ODD = frame(0x210, bytes(range(34))), frame(0x210, bytes(range(30))), frame(0x12345678, b"somebody's")
RESERVED = stream_captures.sealed(header(0x210, 32)[:10] + b"\1\0" + bytes(range(32)))
UDP_PORT, TCP_PORT = (["-d", f"{kind}.port==20001,yapp_serial"] for kind in ("udp", "tcp"))
SERIAL, UDP, TCP = (EXPORTED_PDU, stream_captures.exported_pdu, []), (ETHERNET, stream_captures.udp, UDP_PORT), \
    (ETHERNET, stream_captures.tcp, TCP_PORT)
UDP_FOUND, TCP_FOUND = (ETHERNET, stream_captures.udp, []), (ETHERNET, stream_captures.tcp, [])
UDP_SEARCHED = (ETHERNET, stream_captures.udp, ["-o", "yapp.search_all:TRUE"])  # the head of the file need not have a frame

# Each: a transport, and its packets: the bytes (and how many of them were captured), what is shown, the bytes that wait.
SITUATIONS = {
    "a bridge that sends byte by byte": (UDP_SEARCHED, [
        (ONE, [("good", ONE)]), *[(TWO[at:at + 1], [], TWO[at:at + 1]) for at in range(len(TWO) - 1)], (TWO[-1:], [("good", TWO)])]),
    "a conversation is known by its first whole frame": (UDP_FOUND, [
        (b"text YP text", []), (ONE[:30], [], ONE[:30]), (ONE, [("skipped", ONE[:30]), ("good", ONE)]), (b"text", [])]),
    "a conversation is known by damaged messages": (UDP_FOUND, [
        (DAMAGED * 2, [("bad", DAMAGED)] * 2), (LOST_BYTE, [], LOST_BYTE), (MOTOR, [("incomplete", LOST_BYTE), ("good", MOTOR)])]),
    "a conversation is known by a header": (UDP_FOUND, [(MOTOR[:12], [], MOTOR[:12])]),
    "a conversation is known by a header, TCP": (TCP_FOUND, [(MOTOR[:12], [], MOTOR[:12]), (MOTOR[12:], [("good", MOTOR)])]),
    **{f"a conversation is known by a header: {what}": (UDP_SEARCHED, [(data, [("good", data)])])
       for what, data in {"another size": GROWN, "no known size": SHORT}.items()},
    "a conversation with neither is nobody's": (UDP_FOUND, [(ODD, []), (RESERVED, []), (MOTOR[:11], []), (b"YP" * 30, [])]),
    "the snap length cuts a frame": (SERIAL, [
        (ONE + TWO[:10], [("good", ONE)], TWO[:10]), ((TWO[10:], 15), [("incomplete", TWO[:25])]), (THREE, [("good", THREE)])]),
    "a line that is edited": (SERIAL, [
        (b"> pw\b \bwd\a\r\n\x1b[0m\t41 \xc2\xb0C" + ONE, [("skipped", b"> pw\b \bwd\a\r\n\x1b[0m\t41 \xc2\xb0C"), ("good", ONE)]),
        (b"\xc2\xb0" * 50 + ONE, [("skipped", b"\xc2\xb0" * 50), ("good", ONE)]),
        *((b"x" * length + ONE, [("skipped", b"x" * length), ("good", ONE)]) for length in (79, 80, 81)),
        (b"\xc2\x80" + ONE, [("skipped", b"\xc2\x80"), ("good", ONE)]), (b"\xb0" + ONE, [("skipped", b"\xb0"), ("good", ONE)])]),
    "the snap length cuts a datagram": (UDP, [((ONE, 20), [("incomplete", ONE[:20])]), ((ONE, 3), [("skipped", ONE[:3])]),
                                              ((ONE, 0), []), (TWO, [("good", TWO)])]),
    "the snap length cuts a segment": (TCP, [
        (ONE + TWO[:10], [("good", ONE)], TWO[:10]), ((TWO[10:], 15), [("incomplete", TWO[:25])]), ((ONE, 20), [("incomplete", ONE[:20])]),
        ((ONE, 0), []), (THREE, [("good", THREE)])]),
}


def packets_told(linktype, number, rows, before):
    """The packets of a situation: in a stream with this number, behind so many packets of others."""
    packets, offset, sequence = [], 0, 1
    for row in rows:
        data, events, *pending = row
        data, captured = data if isinstance(data, tuple) else (data, len(data))
        packet = Packet(data, Origin(linktype, 0, 2 * number, address=True, host=number + 1), captured)
        packet.number, packet.sequence = before + len(packets) + 1, sequence
        packet.time = stream_captures.EPOCH + packet.number * 25000  # farther apart than copies of a message
        packet.start, packet.end = offset, offset + captured
        offset, sequence = packet.end, sequence + len(data)
        packet.pending = pending[0] if pending else b""
        packets.append(packet)
        at = packet.end - sum(len(content) for _, content in events) - len(packet.pending)
        for kind, content in events:
            packet.events.append(Event(kind, content, at))
            at += len(content)
        if pending or any(one.pending for one in packets):
            stream_captures.note_parts(packets, packet)
    return packets


def told(names):
    """Situations over the same transport, each in a stream of its own."""
    linktype, link, options = SITUATIONS[names[0]][0]
    packets = []
    for number, name in enumerate(names):
        packets += packets_told(linktype, number, SITUATIONS[name][1], len(packets))
    stream_captures.note_deltas(packets)
    return stream_captures.Capture("told", packets, link, options)


@functools.lru_cache(None)
def problems_of(names, passes):
    capture, folder = told(names), tshark.writable_folder()
    try:
        capture.write(folder / "situations.pcapng")
        return compare(capture, folder / "situations.pcapng", passes)
    finally:
        shutil.rmtree(folder)


@levels.together("situations")
@pytest.mark.parametrize("name", SITUATIONS)
def test_situation(name):
    """All those over one transport in one file, and alone where something is wrong there; in test-all each alone."""
    together = tuple(other for other in SITUATIONS if SITUATIONS[other][0] == SITUATIONS[name][0])
    for passes in PASSES:
        if levels.ALL or problems_of(together, passes):
            problems = problems_of((name,), passes)
            assert not problems, f"{passes}:\n" + "\n".join(problems)


def segment(packet, ports=None, head=b""):
    """A TCP segment of a packet, in IPv6, in a tunnel or whatever its `head` is: bytes, or what makes them of the segment."""
    ports = ports or (50000, 20001)
    flags = getattr(packet, "flags", 0x5018)
    data = struct.pack(">HHIIHHHH", *ports, packet.sequence, packet.acknowledged, flags, 65535, 0, 0) + packet.data
    return head(data) if callable(head) else head + data


def ipv4(data, protocol=6):
    return struct.pack(">BBHIBBH4s4s", 0x45, 0, 20 + len(data), 0, 64, protocol, 0, bytes([10, 0, 0, 1]), bytes([10, 0, 0, 2])) + data


def ipv6(data):
    return struct.pack(">IHBB16s16s", 6 << 28, len(data), 6, 64, bytes(15) + b"\1", bytes(15) + b"\2") + data


# What the segments of a connection come in.
NETWORKS = {
    "IPv6": lambda data: bytes(12) + b"\x86\xdd" + ipv6(data),
    "VLAN": lambda data: bytes(12) + b"\x81\0\0\1\x08\0" + ipv4(data),
    "a tunnel": lambda data: bytes(12) + b"\x08\0" + ipv4(ipv4(data), 4),
}


def test_connections_in_other_networks(folder):
    """Late and repeated segments, a lost one in front of the end; and what an ICMP error quotes of them."""
    a, b, c, d, e = (frame(0x210, bytes([number]) * 32, seq=number) for number in range(5))
    rows = [(0, 1, a), (.1, 97, c), (.2, 49, b), (.3, 49, b), (.4, 145, d), (.5, 241, e)]
    for name, network in NETWORKS.items():
        packets = []
        for seconds, sequence, data in rows:
            packets.append(Packet(data, Origin(ETHERNET, 0, 0)))
            packets[-1].sequence, packets[-1].time = sequence, stream_captures.EPOCH + round(seconds * 1e6)
        packets[-1].flags = 0x5019
        quote = Packet(b"", Origin(ETHERNET, 0, 1))
        quote.time, quote.link = packets[-1].time + 1, lambda _, sent=packets[2]: bytes(12) + b"\x08\0" + ipv4(
            bytes([3, 3, 0, 0, 0, 0, 0, 0]) + ipv4(segment(sent))[:48], 1)
        for packet in packets:
            packet.link = lambda packet, network=network: segment(packet, head=network)
        stream_captures.Capture("", [*packets, quote], lambda packet: packet.link(packet), []).write(folder / "tcp.pcapng")
        for passes in SOME_PASSES[:1] if name == "VLAN" else SOME_PASSES:
            found = shown(folder / "tcp.pcapng", *passes)
            assert {number: row["yapp.seq"] for number, row in found.items() if "yapp.seq" in row} == \
                {1: ["0"], 3: ["1", "2"], 5: ["3"], 6: ["4"]}, name


def test_yapp_behind_64_kb_of_other_datagrams(folder):
    """A packet list needs the preference, a statistic searches all of the file."""
    packets = [Packet(data, Origin(ETHERNET, 0, 2 * number)) for number, data in enumerate([bytes(1000)] * 70 + [MOTOR])]
    for number, packet in enumerate(packets):
        packet.time = stream_captures.EPOCH + number * 1000
    stream_captures.Capture("", packets, stream_captures.udp, []).write(folder / "late.pcapng")
    assert list(shown(folder / "late.pcapng", "-Y", "yapp")) == []
    assert list(shown(folder / "late.pcapng", "-Y", "yapp", "-o", "yapp.search_all:TRUE")) == [71]
    done = tshark.run("-q", "-r", folder / "late.pcapng", "-z", "yapp,check", check=False)
    assert done.returncode == 20 and re.findall(r"FAILED +(\w+)=0", done.stdout) == ["fault", "invalid"]


@pytest.mark.parametrize("arguments", [[], UDP_PORT], ids=["found", "Decode As"])
def test_icmp_quotes_datagrams(arguments, folder):
    """A port that is unreachable: what the error quotes of a datagram has been sent once only."""
    def quote(packet, bytes_of_it=1000):
        datagram = stream_captures.udp(packet)[14:]
        return stream_captures.ethernet(packet, 1, bytes([3, 3, 0, 0, 0, 0, 0, 0]) + datagram[:28 + bytes_of_it])

    packets = [Packet(ONE, Origin(ETHERNET, 0, 0)) for _ in range(5)]
    for number, packet in enumerate(packets):
        packet.number, packet.time = number + 1, stream_captures.EPOCH + number * 15000
    links = {0: quote, 2: quote, 3: lambda packet: quote(packet, 20)}
    stream_captures.Capture("", packets, lambda packet: links.get(packet.number - 1, stream_captures.udp)(packet),
                            arguments).write(folder / "icmp.pcapng")
    for passes in SOME_PASSES:
        found = shown(folder / "icmp.pcapng", *passes, *arguments)
        assert [number for number, row in found.items() if "yapp" in row] == [2, 5]
        assert [found[number].get("yapp.time_delta") for number in (2, 5)] == [None, ["0.045000000"]]
    assert tshark.fields(folder / "icmp.pcapng", ["frame.protocols"], *arguments)[0][0].endswith(":udp:data")


LINKS = {"frame.number", "info", "yapp.fragment", "yapp.reassembled.in", INFO}


@pytest.mark.parametrize("transport", ["UDP", "TCP"])
def test_read_filter(transport, folder):
    """The packets that a read filter leaves have new numbers, and show what they show without it."""
    capture = stream_captures.capture(transport, SEED, 6)
    capture.write(folder / "streams.pcapng")
    lengths = sorted(len(packet.data) for packet in capture.packets)
    filters = ["frame.len > 20 && frame.time_relative > 0.1", f"frame.len > {60 + lengths[len(lengths) // 2]}"]
    every = shown(folder / "streams.pcapng", "-2", *capture.options)
    for read_filter in levels.size(filters[:1], filters):
        kept = [int(number) for (number,) in tshark.fields(folder / "streams.pcapng", ["frame.number"], "-2", "-Y",
                                                           read_filter, *capture.options)]
        left = shown(folder / "streams.pcapng", "-2", "-R", read_filter, *capture.options)
        assert 0 < len(kept) < len(every)
        for number, row in zip(kept, left.values(), strict=True):
            assert {name: value for name, value in row.items() if name not in LINKS} == \
                {name: value for name, value in every[number].items() if name not in LINKS}, f"packet {number}"
