# SPDX-License-Identifier: GPL-2.0-or-later
"""Random serial streams with known truth, and the captures that carry them.

The rules of the framing are read plainly here, everything anew for each prefix of a stream (Oracle): slow, and written
without a look at the plugin.  A stream is cut at random offsets into packets of a transport (TRANSPORTS); what each packet
has to show is its list of events.
"""
import random
import struct

import capture_file
import model
from crc32k import crc32k

KNOWN = {ident: model.MESSAGES[ident].size for ident in sorted(model.MESSAGES)}  # payload sizes
LEAST = {ident: model.MESSAGES[ident].least for ident in KNOWN}
HEADER, CRC = 12, 4
# The largest frame that a stream waits for, with good frames inside of it; and the same if its header is not plausible.
PATIENCE, NOISE_PATIENCE = 4096, 128
EPOCH = 1_700_000_000_000_000


# YAPP ------------------------------------------------------------------------------------------------------------

def header(ident, size, seq=0, ctl=0):
    return b"YP" + struct.pack("<BBIHH", seq, ctl, ident, size, 0)


def sealed(data):
    return data + struct.pack("<I", crc32k(data))


def frame(ident, payload, seq=0, ctl=0):
    return sealed(header(ident, len(payload), seq, ctl) + payload)


# What a stream is made of ----------------------------------------------------------------------------------------

TEXT = [b"> ", b"login: ", b"ps -a\r\n", b"  1 root  0:00 /sbin/init\r\n", b"\x1b[0m$ ", b"ok\r\n", b"YPres\r\n", b"Y"]


def good(rng):
    ident = rng.choice([*KNOWN, rng.randrange(0x300, 0x800), rng.choice([1, 0x20F, 0x211])])
    payload = rng.randbytes(KNOWN.get(ident, rng.choice([0, rng.randrange(40), rng.randrange(300)])))
    return frame(ident, payload, rng.randrange(256), rng.choice([0, 0, rng.randrange(256)]))


def text(rng):
    return b"".join(rng.choices(TEXT, k=rng.randrange(1, 8)))


def noise(rng):
    return rng.randbytes(rng.randrange(1, 60))


def flipped_bit(rng):
    data = bytearray(good(rng))
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def dropped_byte(rng):
    data = good(rng)
    at = rng.randrange(len(data))
    return data[:at] + data[at + 1:]


def grown(rng):
    """A newer firmware's message: more bytes than the catalogue says."""
    ident = rng.choice([*KNOWN])
    return frame(ident, rng.randbytes(KNOWN[ident] + rng.randrange(1, 9)), rng.randrange(256))


def odd(rng):
    """A good CRC, and an ID or reserved bytes that no message of the document has."""
    data = rng.randbytes(rng.randrange(40))
    ident, reserved = rng.choice([(rng.randrange(0x800, 1 << 32), 0), (0x210, 1), (0x300, rng.randrange(1, 0x10000))])
    return sealed(header(ident, len(data))[:10] + struct.pack("<H", reserved) + data)


def damaged_size(rng):
    data = good(rng)
    return data[:8] + struct.pack("<H", rng.choice([rng.randrange(60), rng.randrange(600), 65535])) + data[10:]


def cut(rng):
    data = good(rng)
    return data[:rng.randrange(1, len(data))]


def beheaded(rng):
    data = good(rng)
    return data[rng.randrange(1, len(data)):]


def false_sync(rng):
    return header(rng.randrange(0x300, 0x800), rng.choice([0, rng.randrange(60), rng.randrange(300)])) + noise(rng)


def ruled_out(rng):
    ident, size = rng.randrange(0x800), rng.randrange(40)
    return rng.choice([header(rng.randrange(0x800, 0x10000), size), header(0x10000 + ident, size),
                       header(0x210, rng.choice([31, 33, 0])), header(ident, size)[:10] + b"\0\1"]) + noise(rng)


def many_claims(rng):
    return b"".join(header(rng.randrange(0x300, 0x800), rng.choice([0, rng.randrange(200), 65535])) +
                    rng.randbytes(rng.randrange(5)) for _ in range(rng.randrange(1, 8)))


def inside_a_good_one(rng):
    """Also several, and several levels deep.  A long one has a plausible header, else the stream would not wait for it."""
    inner = good(rng)
    for _ in range(rng.randrange(1, 4)):
        payload = rng.choice([b"", noise(rng)]) + inner + rng.choice([b"", noise(rng), good(rng)])
        is_short = HEADER + len(payload) + CRC <= NOISE_PATIENCE
        inner = frame(rng.choice([*(KNOWN if is_short else []), rng.randrange(0x300, 0x800)]), payload)
    return inner


def inside_a_bad_one(rng):
    data = bytearray(inside_a_good_one(rng))
    data[-rng.randrange(1, 5)] ^= 1
    return bytes(data)


def two_that_overlap(rng):
    """Both have a good CRC; the second one's header is the end of the first one's payload."""
    rest = rng.randbytes(rng.randrange(20))
    second = header(0x400, CRC + len(rest))
    first = frame(0x401, noise(rng) + second)
    return first + rest + sealed(second + first[-CRC:] + rest)[-CRC:]


def yp(rng):
    return b"YP" * rng.randrange(1, 40) + rng.choice([b"", b"Y"])


PIECES = [good] * 8 + [text, text, noise, flipped_bit, dropped_byte, dropped_byte, grown, odd, damaged_size, cut, beheaded, false_sync, ruled_out,
                       many_claims, inside_a_good_one, inside_a_good_one, inside_a_bad_one, two_that_overlap, yp]


def stream(rng, start=b""):
    """The bytes of a stream; starts in the middle of a frame where no start is given."""
    pieces = [rng.choice(PIECES)(rng) for _ in range(rng.choice([rng.randrange(2, 16), rng.randrange(2, 60)]))]
    return (start or rng.choice([b"", beheaded(rng)])) + b"".join(pieces)


def cuts(rng, data):
    """The bytes in pieces of random length: of one byte each, short, long, or mixed."""
    longest = rng.choice([1, 7, 60, 300, 300]) if len(data) < 600 else rng.choice([20, 60, 300, 1400])
    pieces = []
    while data:
        length = rng.randrange(1, longest + 1)
        pieces.append(data[:length])
        data = data[length:]
    return pieces


# The truth -------------------------------------------------------------------------------------------------------

class Event:
    """What a packet shows: kind is good, bad, incomplete or skipped; data its bytes, start their offset in the stream."""

    def __init__(self, kind, data, start):
        self.kind, self.data, self.start, self.end = kind, data, start, start + len(data)
        self.parts, self.delta = [], None

    @property
    def ident(self):
        return struct.unpack("<I", self.data[4:8])[0]

    @property
    def payload(self):
        return self.data[HEADER:HEADER + struct.unpack("<H", self.data[8:10])[0]]

    @property
    def sent_crc(self):
        return struct.unpack("<I", self.data[-CRC:])[0]


def believed(data, at):
    """What a header says: "known", a message of the catalogue with its size; "unknown", an ID of the document's that is none
    of them; "", anything else: then only a good CRC counts."""
    ident, size, reserved = struct.unpack("<IHH", data[at + 4:at + HEADER])
    if reserved or ident > 0x7FF or not LEAST.get(ident, size) <= size <= KNOWN.get(ident, size):
        return ""
    return "known" if ident in KNOWN else "unknown"


def may_be_header(data):
    """Whether the document has a header that begins so, or that stands at the start of these bytes."""
    ident, reserved = data[4:8].ljust(4, b"\0"), data[10:12]
    return struct.unpack("<I", ident)[0] <= 0x7FF and not any(reserved)


class Oracle:
    """Which frames a stream has, and what of them is certain when so many bytes have come."""

    def __init__(self, data, dropped=()):
        self.data, self.dropped = data, set(dropped)  # the candidates that the stream did not wait for
        self.starts = [at for at in range(len(data)) if b"YP".startswith(data[at:at + 2])]
        self.whole, self.open = [], []  # the candidates: (start, end, good), and those whose end never comes
        self.belief = {}  # of each, by start
        for at in self.starts:
            if at + HEADER <= len(data):
                self.belief[at] = believed(data, at)
                end = at + HEADER + struct.unpack("<H", data[at + 8:at + 10])[0] + CRC
                if end > len(data):
                    self.open.append((at, end))
                else:
                    sent = struct.unpack("<I", data[end - CRC:end])[0]
                    self.whole.append((at, end, crc32k(data[at:end - CRC]) == sent))

    def good(self, came, ended):
        """The good frames: where two overlap, the one that begins first.  While the stream goes on, frames wait for an open
        candidate that begins before them.  One that is larger than a stream waits for is noise."""
        taken, at = [], 0
        for start, end, is_good in sorted([*self.whole, *((start, end, False) for start, end in self.open)]):
            if start < at or start + HEADER > came or start in self.dropped:
                continue
            if end > came:
                patience = {"known": 65551, "unknown": PATIENCE, "": NOISE_PATIENCE}[self.belief[start]]
                if end - start > patience:
                    self.dropped.add(start)
                elif not ended:
                    break
            elif is_good:
                taken.append((start, end))
                at = end
        return taken

    def waiting(self, came, after):
        """Where the first candidate begins that may still prove good, or what may be a header."""
        whole = [start for start, end, _ in self.whole if start >= after and start + HEADER <= came < end and start not in self.dropped]
        unfinished = [start for start, _ in self.open if start >= after and start + HEADER <= came and start not in self.dropped]
        headers = [at for at in range(max(after, came - HEADER + 1), came) if b"YP".startswith(self.data[at:min(at + 2, came)])]
        return min(whole + unfinished + headers, default=came)

    def damaged(self, came, start, limit, behind):
        """What lies between good frames, and how far that is decided.  A message of the catalogue goes up to where the next
        begins; behind the limit is a "good" frame, the "end", or what is "open"."""
        events, at = [], start
        for first, end in sorted((one[0], one[1]) for one in [*self.whole, *self.open] if one[0] + HEADER <= came):
            if not self.belief[first] or first in self.dropped or not at <= first < limit:
                continue
            stop = min([one for one, belief in self.belief.items() if belief == "known" and first < one < limit], default=limit)
            if end > stop and stop == limit and behind == "open":
                limit = first
                break
            if end <= stop or self.belief[first] == "known" or stop == limit and behind == "end":
                events += [("skipped", at, first), ("bad" if end <= stop else "incomplete", first, min(end, stop))]
                at = min(end, stop)
        return events + [("skipped", at, limit)], limit

    def tiles(self, came, ended):
        """The events of a prefix, and where what waits begins."""
        events, at = [], 0
        for start, end in self.good(came, ended):
            events += self.damaged(came, at, start, "good")[0] + [("good", start, end)]
            at = end
        last, done = self.damaged(came, at, came, "end") if ended else self.damaged(came, at, self.waiting(came, at), "open")
        return events + last, done

    def events(self, came, known=0, ended=False):
        """The events that are certain when `came` bytes have come, from the offset `known` on; and how far they go."""
        tiles, done = self.tiles(came, ended)
        assert done >= known
        events = [Event(kind, self.data[max(start, known):end], max(start, known)) for kind, start, end in tiles
                  if end > known and end > start]
        assert all(event.kind == "skipped" or event.start >= known for event in events)
        assert b"".join(event.data for event in events) == self.data[known:done]
        return events, done


class Packet:
    """A packet of a capture, and what it has to show."""

    def __init__(self, data, origin, captured=None):
        self.data, self.origin = data, origin
        self.captured = len(data) if captured is None else captured
        self.events, self.pending, self.leads_to = [], b"", set()
        self.time = self.number = self.sequence = None
        self.acknowledged = 1
        self.bus = ""
        self.link = lambda packet: packet.data


# How the pieces of a stream come ---------------------------------------------------------------------------------

def note_parts(packets, last, events=None):
    """Which packets the frames came in that the last one shows."""
    for event in last.events if events is None else events:
        if event.kind != "skipped":
            event.parts = [one for one in sorted(packets, key=lambda one: one.start) if one.end > max(event.start, one.start) and one.start < event.end]
            for one in event.parts:
                one.leads_to |= {last} - {one}


class Stream:
    """One direction of a conversation.  Where a conversation in UDP was found by content, a datagram without a frame is
    others', unless it goes on with a frame or begins one."""

    def __init__(self, origin, by_content=False):
        self.origin, self.by_content = origin, by_content
        self.begin()

    def begin(self):
        self.run, self.data, self.done, self.dropped = [], b"", 0, set()  # packets and bytes since nothing waited

    def events(self, shower, ended=False):
        oracle = Oracle(self.data, self.dropped)
        found, self.done = oracle.events(len(self.data), self.done, ended)
        self.dropped = oracle.dropped
        note_parts(self.run, shower, found)
        return found

    def add(self, packet, skipped, shower):
        """The bytes of a packet but for those that came before; -> what the packet shows that brings them."""
        if self.done == len(self.data):
            self.begin()
        packet.start, packet.end = len(self.data), len(self.data) + len(packet.data) - skipped
        self.data += packet.data[skipped:]
        self.run.append(packet)
        return self.events(shower)

    def waiting(self, packet):
        return self.data[max(self.done, packet.start):packet.end]

    def next(self, data):
        packet, waited = Packet(data, self.origin), self.done < len(self.data)
        packet.events = self.add(packet, 0, packet)
        packet.pending = self.waiting(packet)
        is_begun = bool(packet.pending) and (may_be_header(packet.pending) if len(packet.pending) > 1 else len(data) == 1)
        if self.by_content and not (waited or is_begun or any(event.kind != "skipped" for event in packet.events)):
            packet.events, packet.pending = [], b""
            self.begin()
        return packet


def merged(events):
    """Skipped bytes that follow skipped bytes are one event."""
    result = []
    for event in events:
        if result and result[-1].kind == event.kind == "skipped":
            event = Event("skipped", result.pop().data + event.data, event.start)
        result.append(event)
    return result


MAX_HELD = 16  # segments behind a lost one: then it is given up


class Connection(Stream):
    """One direction of a TCP connection: segments come in any order, and those behind a gap wait."""

    def __init__(self, origin):
        super().__init__(origin)
        self.held, self.expected = [], 0

    def next(self, data, at):
        packet, found = Packet(data, self.origin), []
        packet.sequence, packet.pending = at + 1, data
        self.held = sorted([*self.held, packet], key=lambda one: one.sequence)
        while self.held:
            first = self.held[0]
            overlap = self.expected + 1 - first.sequence
            if overlap < 0:
                if len(self.held) < MAX_HELD:
                    break
                found += self.events(packet, ended=True)
                self.begin()
                self.expected, overlap = first.sequence - 1, 0
            self.held.pop(0)
            first.pending = b"" if first is packet else first.pending
            if overlap < len(first.data):
                found += self.add(first, overlap, packet)
                self.expected += len(first.data) - overlap
        packet.events = merged(found)
        if packet in self.run:
            packet.pending = self.waiting(packet)
        return packet


def in_order(rng, data, origin):
    stream = Stream(origin)
    return [stream.next(piece) for piece in cuts(rng, data)]


def datagrams(by_content, lost=0.0):
    """The first one has a whole frame and so tells what the conversation is."""
    def arrive(rng, data, origin):
        stream = Stream(origin, by_content)
        return [stream.next(piece) for piece in [good(rng), *(piece for piece in cuts(rng, data) if rng.random() >= lost)]]
    return arrive


def segments(change):
    """The first one has a whole frame and so tells what the connection is; the others come as `change` has it."""
    def arrive(rng, data, origin):
        first, pieces = good(rng), []
        at = len(first)
        for piece in cuts(rng, data):
            pieces.append((at, at + len(piece)))
            at += len(piece)
        connection, data = Connection(origin), first + data
        return [connection.next(data[start:end], start) for start, end in [(0, len(first)), *change(rng, pieces)]]
    return arrive


def unchanged(_, pieces):
    return pieces


def repeated(rng, pieces):
    """Segments that come twice, with less or more than before, and such as begin in what came before."""
    changed = []
    for start, end in pieces:
        changed.append((rng.choice([start, start, rng.randrange(start + 1)]), end))
        while rng.random() < 0.3:
            again = rng.choice(changed)[0]
            changed.append((again, rng.randrange(again, end) + 1))
    return [(max(start, end - 1400), end) for start, end in changed]


def disordered(rng, pieces):
    """Some segments come late, and some of them twice."""
    order = sorted(range(len(pieces)), key=lambda i: i if rng.random() < 0.7 else i + rng.randrange(1, 5))
    return [pieces[i] for i in order for _ in range(rng.choice([1, 1, 1, 2]))]


def with_gaps(rng, pieces):
    """Some segments are not in the capture."""
    return [piece for piece in pieces if rng.random() > 0.1]


# Carriers -------------------------------------------------------------------------------------------------------------

USER0, ETHERNET, RTAC, EXPORTED_PDU, USBMON, USBPCAP = 147, 1, 250, 252, 220, 249


class Origin:
    """Where a stream was captured: interface, and the number of the stream, of which come two to a conversation."""

    def __init__(self, linktype, interface, number, address=None, host=1, has_flags=False):
        self.linktype, self.interface, self.number, self.address, self.host = linktype, interface, number, address, host
        self.direction, self.pair, self.has_flags = number % 2, number // 2, has_flags
        self.bus_direction = (has_flags or linktype == RTAC) * ("tx", "rx")[self.direction]


def addresses(origin):
    here, there = bytes([192, 0, 2, origin.host]), bytes([198, 51, 100, origin.pair // 2 % 250 + 1])
    ports = (50000 + origin.pair, 20001)
    return (here, there, *ports) if origin.direction == 0 else (there, here, *ports[::-1])


def raw(packet):
    return packet.data


def rtac(packet):
    return struct.pack(">IIBBH", packet.time // 10**6, packet.time % 10**6, 1 + packet.origin.direction, 0, 0) + packet.data


def exported_pdu(packet):
    tags = [(12, b"yapp_serial\0")]
    if packet.origin.address:
        source, target, source_port, target_port = addresses(packet.origin)
        tags += [(20, source), (21, target), (24, bytes(4)), (25, struct.pack(">I", source_port)),
                 (26, struct.pack(">I", target_port))]
    return b"".join(struct.pack(">HH", tag, len(value)) + value for tag, value in [*tags, (0, b"")]) + packet.data


def ethernet(packet, protocol, segment):
    source, target = addresses(packet.origin)[:2]
    return (bytes(12) + b"\x08\0" + struct.pack(">BBHIBBH", 0x45, 0, 20 + len(segment), 0, 64, protocol, 0) + source +
            target + segment)


def udp(packet):
    ports = addresses(packet.origin)[2:]
    return ethernet(packet, 17, struct.pack(">HHHH", *ports, 8 + len(packet.data), 0) + packet.data)


def tcp(packet):
    ports = addresses(packet.origin)[2:]
    return ethernet(packet, 6, struct.pack(">HHIIHHHH", *ports, packet.sequence, packet.acknowledged, 0x5018, 65535, 0, 0) + packet.data)


BULK = 3  # a transfer of USB


def usbmon(transfer, endpoint, data, device):
    event = b"C" if endpoint >= 0x80 else b"S"
    return (bytes(8) + event + bytes([transfer, endpoint, device]) + struct.pack("<HBBqiiII", 2, 0x2D, 0, 0, 0, 0, len(data), len(data)) +
            bytes(24) + data)


def usbpcap(transfer, endpoint, data, device):
    return struct.pack("<HQIHBHHBBI", 27, 0, 0, 9, int(endpoint >= 0x80), 2, device, endpoint, transfer, len(data)) + data


def with_status(data, size):
    """As FTDI's adapters send it: two bytes of status in front of each packet of the bus."""
    status = b"\x01\x60" if size == 64 else b"\x02\x60"
    return b"".join(status + data[at:at + size - 2] for at in range(0, len(data), size - 2))


def adapter(header, carry=lambda data: data):
    """Both directions of an adapter, whose endpoints have one number; the device tells the pair."""
    def link(packet):
        endpoint, data = 0x81 if packet.origin.direction == 0 else 0x01, packet.data
        return header(BULK, endpoint, carry(data) if endpoint >= 0x80 else data, 1 + packet.origin.pair)
    return link


LINKS = {USER0: raw, RTAC: rtac, EXPORTED_PDU: exported_pdu}
UAT = ["-o", 'uat:user_dlts:"User 0 (DLT=147)","yapp_serial","0","","0",""']
NOT_ANALYZED = ["-o", "tcp.analyze_sequence_numbers:FALSE", "-o", "tcp.no_subdissector_on_error:FALSE"]
OUT_OF_ORDER = ["-o", "tcp.reassemble_out_of_order:TRUE"]
AS_SERIAL = ["-d", "rtacser.data,yapp_serial"]


def interfaces(linktype):
    return lambda number: Origin(linktype, number, number)


def in_pairs(linktype):
    """Two streams on each interface, told apart by direction."""
    return lambda number: Origin(linktype, number // 2, number)


def by_flags(linktype):
    """The same by the direction in the flags of each packet: inbound or outbound."""
    return lambda number: Origin(linktype, number // 2, number, has_flags=True)


def on_one(linktype):
    """Each conversation has addresses of its own: one address with many ports may be a sender that takes new ones."""
    return lambda number: Origin(linktype, 0, number, address=True, host=number // 2 % 250 + 1)


def mixed(number):
    kinds = [(USER0, 0), (EXPORTED_PDU, 0), (RTAC, 0), (RTAC, 1), (EXPORTED_PDU, 2), (EXPORTED_PDU, 3)]
    linktype, direction = kinds[number % 6]
    group = number // 6 * 4
    interface = group + [0, 1, 2, 2, 3, 3][number % 6]
    return Origin(linktype, interface, 2 * number + direction % 2, address=direction >= 2)


# Name: where the streams are, how their pieces come, how a packet looks on the link, and what tshark needs.
TRANSPORTS = {
    "DLT_USER, by the table": (interfaces(USER0), in_order, raw, UAT),
    "DLT_USER, by the preference": (interfaces(USER0), in_order, raw, ["-o", "yapp.user_dlt:147"]),
    "DLT_USER, directions by flags": (by_flags(USER0), in_order, raw, ["-o", "yapp.user_dlt:147"]),
    "exported PDU, by interface": (interfaces(EXPORTED_PDU), in_order, exported_pdu, []),
    "exported PDU, by address": (on_one(EXPORTED_PDU), in_order, exported_pdu, []),
    "RTAC": (in_pairs(RTAC), in_order, rtac, AS_SERIAL),
    "several kinds of link": (mixed, in_order, None, [*UAT, *AS_SERIAL]),
    "UDP": (on_one(ETHERNET), datagrams(True), udp, []),
    "UDP, Decode As": (on_one(ETHERNET), datagrams(False), udp, ["-d", "udp.port==20001,yapp_serial"]),
    "TCP": (on_one(ETHERNET), segments(unchanged), tcp, []),
    "TCP, Decode As": (on_one(ETHERNET), segments(unchanged), tcp, ["-d", "tcp.port==20001,yapp_serial"]),
    "TCP, segments missing": (on_one(ETHERNET), segments(with_gaps), tcp, []),
    "TCP, segments repeated": (on_one(ETHERNET), segments(repeated), tcp, []),
    "TCP, late, twice and missing": (on_one(ETHERNET), segments(lambda *all: with_gaps(all[0], disordered(*all))), tcp, []),
    "TCP, out of order": (on_one(ETHERNET), segments(disordered), tcp, []),
    "TCP, out of order, Wireshark reassembles": (on_one(ETHERNET), segments(disordered), tcp, OUT_OF_ORDER),
    "TCP that joins nothing": (on_one(ETHERNET), segments(disordered), tcp, ["-o", "tcp.desegment_tcp_streams:FALSE"]),
    "TCP that is not analyzed": (on_one(ETHERNET), segments(disordered), tcp, NOT_ANALYZED),
    "USB, usbmon": (on_one(USBMON), datagrams(False), adapter(usbmon), []),
    "USB, FTDI in usbmon": (on_one(USBMON), datagrams(False), adapter(usbmon, lambda data: with_status(data, 64)), []),
    "USB, USBPcap": (on_one(USBPCAP), datagrams(False), adapter(usbpcap), []),
    "UDP, datagrams missing": (on_one(ETHERNET), datagrams(True, 0.1), udp, []),
}


# The files -------------------------------------------------------------------------------------------------------

class Capture:
    """Streams of one transport in a pcapng file."""

    def __init__(self, transport, packets, link, options):
        self.transport, self.link, self.options = transport, link, options
        self.packets = packets
        origins = {packet.origin.interface: packet.origin.linktype for packet in packets}
        self.linktypes = [origins.get(interface, USER0) for interface in range(max(origins, default=0) + 1)]
        self.buses = {(packet.origin.interface, packet.origin.bus_direction) for packet in packets}
        for packet in packets:
            packet.bus = self.bus_name(packet.origin)

    def bus_name(self, origin):
        """The name that tells the bus of a packet from others, "" where the capture has one bus."""
        if len(self.buses) < 2:
            return ""
        has_both = {(origin.interface, "rx"), (origin.interface, "tx")} <= self.buses
        return f"if{origin.interface}" + has_both * f"#{origin.bus_direction}"

    def head(self):
        return capture_file.section(*map(capture_file.interface, self.linktypes))

    @staticmethod
    def packet_block(packet, data):
        captured = len(data) - len(packet.data) + packet.captured
        flags = struct.pack("<HHIHH", 2, 4, 2 - packet.origin.direction, 0, 0) if packet.origin.has_flags else b""
        return capture_file.packet(packet.time, data, packet.origin.interface, captured, flags)

    def bytes(self):
        return self.head() + b"".join(
            self.packet_block(packet, (self.link or LINKS[packet.origin.linktype])(packet)) for packet in self.packets)

    def write(self, path):
        path.write_bytes(self.bytes())


def interleaved(rng, streams):
    """The packets of all streams, each stream's in their order; numbered, and with times."""
    streams = [list(reversed(packets)) for packets in streams if packets]
    result, now = [], EPOCH
    while streams:
        packets = rng.choice(streams)
        packet = packets.pop()
        now += 400_000 if getattr(packet, "late", False) else rng.randrange(20, 5_000)
        packet.time, packet.number = now, len(result) + 1
        result.append(packet)
        streams = [one for one in streams if one]
    return result


def note_deltas(packets):
    """The times of good messages since the previous message with the same ID of the same sender."""
    previous = {}
    for packet in packets:
        origin = packet.origin
        for event in packet.events:
            if event.kind == "good":
                # In UDP and TCP a controller is one source, whoever talks with it; it receives Commands.
                source = addresses(origin)[event.ident == 0] if origin.linktype == ETHERNET else (origin.pair, origin.direction)
                key = (origin.interface, source, event.ident)
                event.delta = (packet.time - previous[key]) * 1000 if key in previous else None
                previous[key] = packet.time


def capture(transport, seed, count):
    """A random capture of so many streams."""
    rng = random.Random(f"{seed}, {transport}")
    where, arrive, link, options = TRANSPORTS[transport]
    streams = []
    for number in range(count):
        streams.append(arrive(rng, stream(rng), where(number)))
    packets = interleaved(rng, streams)
    note_deltas(packets)
    return Capture(transport, packets, link, options)
