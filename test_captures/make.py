#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes the captures of can/ and serial/: the text NAME.frames becomes NAME.pcap, or NAME.pcapng.

    make.py             makes all of them
    make.py NAME ...    makes these

A line of a .frames file is a comment (#), a setting, or a packet:

    link can            what carries YAPP: can, sll, sll2, user0, rtac, pdu (exported PDU of yapp_serial), udp, tcp
    records kernel      CAN records of 16 bytes, of CAN FD 72, as Linux hands them to a capturing program; without this
                        line they end with the data
    format pcapng       with one interface for each bus; without this line pcap, where only sll2 knows the bus
    options -o x:y      what tshark needs for NAME.expected, see expected.py
    let motor = FD 7F   names bytes; $motor stands for them

    0.100 can0 08404000 BB BE 6F C7 20 00 00 00     CAN: time in seconds, bus, id, data as candump prints them
    0.100 can0 fd 08404000 BB BE 6F C7              CAN FD
    0.100 can0 rtr 08404000 8                       remote frame with the length 8 and no data, or with "8 00*8";
                                                    an id of three digits is a standard one
    0.100 can0 err 00000004 00 08 00 00             error frame
    0.100 can0 [210 $motor]                         all frames of a message, with its CRC
    0.100 > "login: " [210 $motor] 59 50            serial, UDP, TCP: direction (> or <), text, messages, bytes

Without a time a packet comes 1 ms after the previous one. In data
    BB*8 repeats a byte; @18 goes on at byte 18, over what is there; | marks where the snap length cuts the packet.
In brackets
    [ID/SEQ/CTL data] is a message, ID and SEQ and CTL hexadecimal, SEQ and CTL 0 when left out;
    [!ID data] has a wrong CRC; on CAN an error if the message fits into one frame, which has no CRC.
"""
import functools
import pathlib
import re
import shlex
import struct
import sys

FOLDER = pathlib.Path(__file__).resolve().parent
KINDS = ("can", "serial")  # folders
EPOCH = 1700000000
LINKTYPES = {"can": 227, "sll": 113, "sll2": 276, "user0": 147, "rtac": 250, "pdu": 252, "udp": 1, "tcp": 1}
CAN_LINKS = ("can", "sll", "sll2")
SNAPLEN = 65535
FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
TOKEN = re.compile(r'"[^"]*"|[][|]|[^]["|\s]+')


# YAPP ------------------------------------------------------------------------------------------------------------

def crc32k(data, register=0xFFFFFFFF):
    """CRC-32K/6.4 a bit at a time: polynomial 0x1'32C0'0699, not reflected, no final xor."""
    for byte in data:
        register ^= byte << 24
        for _ in range(8):
            register <<= 1
            if register >> 32:
                register ^= 0x132C00699
    return register


def message_crc(message):
    crc = crc32k(serial_header(message) + message["payload"])
    return crc ^ 0xFF if message["wrong_crc"] else crc


def serial_header(message):
    return b"YP" + struct.pack("<BBIHH", message["seq"], message["ctl"], message["id"], len(message["payload"]), 0)


def serial_frame(message):
    return serial_header(message) + message["payload"] + struct.pack("<I", message_crc(message))


def can_frames(message, fd):
    """A message as [(CAN id, data)]."""
    def can_id(ctrl):
        return message["id"] << 18 | ctrl << 14 | message["ctl"] << 8 | message["seq"]

    payload, most = message["payload"], 64 if fd else 8
    if len(payload) <= most:
        return [(can_id(0), padded(payload, fd))]
    chunks = [payload[at:at + most] for at in range(0, len(payload), most)]
    start = struct.pack("<IHH", message_crc(message), len(payload), 0)
    return ([(can_id(1), start)] + [(can_id(2), chunk) for chunk in chunks[:-1]]
            + [(can_id(3), padded(chunks[-1], fd))])


def padded(data, fd):
    length = next(length for length in FD_LENGTHS if length >= len(data)) if fd and len(data) > 8 else len(data)
    return data.ljust(length, b"\0")


# The text --------------------------------------------------------------------------------------------------------

class Source:
    """A .frames file: its settings, .packets [(microseconds, bus, bytes, length on the wire)], and .messages, the
    bracketed ones, each with the number of its last packet as "frame", on CAN with those of all as "frames"."""

    def __init__(self, text):
        self.link, self.format, self.records, self.options = "can", "pcap", "", []
        self.names, self.packets, self.messages, self.buses = {}, [], [], []
        self.sequence = {">": 1, "<": 1}
        self.time = -1000
        for number, line in enumerate(text.splitlines(), 1):
            line = line.split("#")[0]
            try:
                if line.startswith("options "):
                    self.options = shlex.split(line)[1:]
                elif line.strip():
                    self.line(TOKEN.findall(line))
            except (ValueError, KeyError, IndexError) as error:
                raise SystemExit(f"line {number}: {line}: {error!r}") from error

    def line(self, tokens):
        word = tokens[0]
        if word in ("link", "format", "records"):
            setattr(self, word, tokens[1])
        elif word == "let":
            self.names[tokens[1]] = self.data(tokens[3:])[0]
        else:
            self.time += 1000
            if "." in word:
                self.time = round(float(word) * 1e6)
                tokens = tokens[1:]
            source = tokens[0]
            if source not in self.buses:
                self.buses.append(source)
            (self.can_line if self.link in CAN_LINKS else self.stream_line)(source, tokens[1:])

    def data(self, tokens):
        """Bytes, and how many of them were captured."""
        data, at, captured, tokens = bytearray(), 0, None, list(tokens)
        while tokens:
            token = tokens.pop(0)
            if token == "|":
                captured = len(data)
                continue
            if token.startswith("@"):
                at = int(token[1:])
                continue
            if token == "[":
                end = tokens.index("]")
                piece, tokens = serial_frame(self.message(tokens[:end])), tokens[end + 1:]
            elif token.startswith('"'):
                piece = token[1:-1].encode().decode("unicode_escape").encode("latin-1")
            elif token.startswith("$"):
                piece = self.names[token[1:]]
            else:
                byte, _, count = token.partition("*")
                piece = bytes.fromhex(byte) * int(count or 1)
            data[at:at + len(piece)] = piece
            at += len(piece)
        return bytes(data), len(data) if captured is None else captured

    def message(self, tokens):
        numbers = [int(part, 16) for part in tokens[0].lstrip("!").split("/")]
        ident, seq, ctl = numbers + [0] * (3 - len(numbers))
        message = {"id": ident, "seq": seq, "ctl": ctl, "payload": self.data(tokens[1:])[0],
                   "wrong_crc": tokens[0].startswith("!"), "frame": len(self.packets) + 1}
        self.messages.append(message)
        return message

    def add(self, bus, packet, missing=0):
        self.packets.append((self.time, bus, packet[:len(packet) - missing], len(packet)))

    def can_line(self, bus, tokens):
        kind = tokens.pop(0) if tokens[0] in ("fd", "rtr", "err") else ""
        if tokens[0] == "[":
            message = self.message(tokens[1:-1])
            frames = can_frames(message, kind == "fd")
            if message["wrong_crc"] and len(frames) == 1:
                raise ValueError(f"[!{message['id']:X} ...] fits into one CAN frame, which has no CRC: leave out the !")
            for index, (can_id, data) in enumerate(frames):
                self.time += 200 if index else 0
                self.add(bus, self.can_record(bus, can_id | EXTENDED, data, kind == "fd"))
            message["frames"] = list(range(message["frame"], len(self.packets) + 1))
            message["frame"] = len(self.packets)
            return
        can_id = int(tokens[0], 16) | {"rtr": REMOTE, "err": ERROR}.get(kind, 0)
        if len(tokens[0]) == 8 and kind != "err":
            can_id |= EXTENDED
        length = int(tokens.pop(1)) if kind == "rtr" else None
        data, captured = self.data(tokens[1:])
        self.add(bus, self.can_record(bus, can_id, data, kind == "fd", length), len(data) - captured)

    def can_record(self, bus, can_id, data, fd, length=None):
        """The CAN id is big endian, in cooked captures little endian as the host had it."""
        rest = struct.pack("BBBB", len(data) if length is None else length, 4 if fd else 0, 0, 0) + data
        if self.records == "kernel":
            rest = rest.ljust(68 if fd else 12, b"\0")
        if self.link == "can":
            return struct.pack(">I", can_id) + rest
        protocol, index = 0x0D if fd else 0x0C, self.buses.index(bus) + 1
        header = struct.pack(">HHH8xH", 0, 280, 0, protocol) if self.link == "sll" else \
            struct.pack(">HHIHBB8x", protocol, 0, index, 280, 0, 0)
        return header + struct.pack("<I", can_id) + rest

    def stream_line(self, direction, tokens):
        data, captured = self.data(tokens)
        self.add(None, STREAMS[self.link](self, direction, data), len(data) - captured)

    def rtac(self, direction, data):
        return struct.pack(">IIBBH", EPOCH + self.time // 10**6, self.time % 10**6, 1 if direction == ">" else 2, 0,
                           0) + data

    def exported_pdu(self, _, data):
        name = b"yapp_serial\0"
        return struct.pack(">HH", 12, len(name)) + name + struct.pack(">HH", 0, 0) + data

    def udp(self, direction, data):
        source, target = PORTS if direction == ">" else PORTS[::-1]
        return ip(17, direction, struct.pack(">HHHH", source, target, 8 + len(data), 0) + data, 6)

    def tcp(self, direction, data):
        source, target = PORTS if direction == ">" else PORTS[::-1]
        acknowledged = self.sequence["<" if direction == ">" else ">"]
        header = struct.pack(">HHIIHHHH", source, target, self.sequence[direction], acknowledged, 0x5018, 65535, 0, 0)
        self.sequence[direction] += len(data)
        return ip(6, direction, header + data, 16)


STREAMS = {"user0": lambda _source, _direction, data: data, "rtac": Source.rtac, "pdu": Source.exported_pdu,
           "udp": Source.udp, "tcp": Source.tcp}
PORTS = (50000, 20001)
ADDRESSES = (bytes([192, 0, 2, 1]), bytes([192, 0, 2, 2]))


def checksum(data):
    total = sum(struct.unpack(f">{(len(data) + 1) // 2}H", data + b"\0" * (len(data) % 2)))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return total ^ 0xFFFF


def ip(protocol, direction, segment, checksum_at):
    """Ethernet and IPv4 around a UDP or TCP segment, whose checksum goes to checksum_at."""
    source, target = ADDRESSES if direction == ">" else ADDRESSES[::-1]
    pseudo = source + target + struct.pack(">HH", protocol, len(segment))
    total = struct.pack(">H", checksum(pseudo + segment))
    segment = segment[:checksum_at] + total + segment[checksum_at + 2:]
    header = struct.pack(">BBHIBBH", 0x45, 0, 20 + len(segment), 0, 64, protocol, 0) + source + target
    header = header[:10] + struct.pack(">H", checksum(header)) + header[12:]
    macs = bytes([2, 0, 0, 0, 0, 2, 2, 0, 0, 0, 0, 1])
    return (macs if direction == ">" else macs[6:] + macs[:6]) + b"\x08\0" + header + segment


# The files -------------------------------------------------------------------------------------------------------

def pcap(source):
    parts = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, SNAPLEN, LINKTYPES[source.link])]
    for time, _, packet, length in source.packets:
        parts.append(struct.pack("<IIII", EPOCH + time // 10**6, time % 10**6, len(packet), length) + packet)
    return b"".join(parts)


def block(kind, body):
    body += b"\0" * (-len(body) % 4)
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def interface(link, name):
    text = name.encode()
    option = struct.pack("<HH", 2, len(text)) + text + b"\0" * (-len(text) % 4) + struct.pack("<HH", 0, 0)
    return block(1, struct.pack("<HHI", LINKTYPES[link], 0, SNAPLEN) + option)


def pcapng(*sources):
    """One source after the other, each with its own interfaces: one for each bus, one in all of what is pcap alone."""
    interfaces, packets = [], []
    for source in sources:
        buses = source.buses if source.format == "pcapng" else [""]
        for time, bus, packet, length in source.packets:
            stamp, index = EPOCH * 10**6 + time, buses.index(bus) if len(buses) > 1 else 0
            packets.append(block(6, struct.pack("<IIIII", len(interfaces) + index, stamp >> 32, stamp & 0xFFFFFFFF,
                                                len(packet), length) + packet))
        interfaces += [interface(source.link, name) for name in buses]
    return b"".join([block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)), *interfaces, *packets])


@functools.lru_cache(None)
def texts():
    """The texts of the captures: { name: path }."""
    return {path.stem: path for kind in KINDS for path in sorted((FOLDER / kind).glob("*.frames"))}


@functools.lru_cache(None)
def read(name):
    return Source(texts()[name].read_text())


def names():
    return sorted(texts())


def capture(name):
    """The capture of a text: where it belongs, and its bytes."""
    source = read(name)
    return texts()[name].with_suffix(f".{source.format}"), {"pcap": pcap, "pcapng": pcapng}[source.format](source)


if __name__ == "__main__":
    for one in sys.argv[1:] or names():
        path, content = capture(one)
        path.write_bytes(content)
