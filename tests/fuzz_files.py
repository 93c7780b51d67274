# SPDX-License-Identifier: GPL-2.0-or-later
"""The files that fuzz.py shows: YAPP on every carrier, text and dumps for every reader, captures of ours; all damaged.

Everything comes out of a random.Random: the same one makes the same file.
"""
import functools
import math
import pathlib
import re
import shlex
import struct
import subprocess
import tempfile

import model
import stream_captures
from crc32k import crc32k
from stream_captures import USBMON, USBPCAP, usbmon

CAPTURES = pathlib.Path(__file__).resolve().parents[1] / "test_captures"
FINDINGS = CAPTURES / "fuzz"
MESSAGES = [(ident, message.size) for ident, message in model.MESSAGES.items()]
OTHER_IDS = [0x001, 0x100, 0x211, 0x300, 0x301, 0x7FF]
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
ETHERNET, RAW_IP, SLL, SOCKETCAN, USER0, RTAC, PDU, SLL2 = 1, 101, 113, 227, 147, 250, 252, 276
USBMON_48 = 189


# YAPP ------------------------------------------------------------------------------------------------------------

def some_bytes(rng, size):
    kind = rng.random()
    if kind < 0.6:
        return rng.randbytes(size)
    if kind < 0.8:  # values at the ends of their ranges
        return bytes(rng.choice((0, 1, 0x7F, 0x80, 0xFA, 0xFB, 0xFC, 0xFD, 0xFE, 0xFF)) for _ in range(size))
    return (rng.choice((b"\0", b"\xff", b"YP", b"\x01")) * size)[:size]


def message(rng):
    """A message: header and payload, and its CRC, mostly right."""
    ident, size = rng.choice(MESSAGES)
    if rng.random() < 0.2:
        ident = rng.choice(OTHER_IDS) if rng.random() < 0.7 else rng.randrange(2048)
    if rng.random() < 0.15:
        size = rng.choice((0, 1, 3, 8, 9, 63, 64, 65, size - 1, size + 1, rng.randrange(600)))
    payload = some_bytes(rng, size)
    seq = rng.randrange(256) if rng.random() < 0.2 else 0
    ctl = rng.randrange(256) if rng.random() < 0.05 else 0
    reserved = rng.randrange(65536) if rng.random() < 0.05 else 0
    header = b"YP" + struct.pack("<BBIHH", seq, ctl, ident, size, reserved)
    crc = crc32k(header + payload)
    if rng.random() < 0.1:
        crc ^= 1 << rng.randrange(32)
    return header, payload, crc


def can_frames(rng, fd):
    """The frames of a message as [(CAN id, data, FD)]; now and then one is wrong, missing, twice or early."""
    header, payload, crc = message(rng)
    seq, ctl, ident, size, reserved = struct.unpack("<BBIHH", header[2:])
    most = 64 if fd else 8

    def can_id(ctrl):
        return EXTENDED | ident << 18 | ctrl << 14 | (ctl & 0x3F) << 8 | seq

    if len(payload) <= most and rng.random() < 0.9:
        frames = [(can_id(0), payload)]
    else:
        if rng.random() < 0.05:
            size = rng.choice((0, 1, 9, 32, 65535, rng.randrange(65536)))
        frames = [(can_id(1), struct.pack("<IHH", crc, size, reserved))]
        frames += [(can_id(2), payload[at:at + most]) for at in range(0, len(payload), most)]
        frames[-1] = (can_id(3), frames[-1][1])
    if fd:
        frames = [(one, data.ljust(next(n for n in FD_LENGTHS if n >= len(data)), b"\0")) for one, data in frames]
    if rng.random() < 0.25:
        at, kind = rng.randrange(len(frames)), rng.randrange(7)
        one, data = frames[at]
        if kind == 0:
            del frames[at]
        elif kind == 1:
            frames.insert(rng.randrange(len(frames) + 1), frames[at])
        elif kind == 2:
            frames.insert(rng.randrange(len(frames)), frames.pop(at))
        elif kind == 3:
            frames[at] = (one ^ 1 << rng.randrange(32), data)
        elif kind == 4:
            frames[at] = (one & ~0x3C000 | rng.randrange(16) << 14, data)
        elif kind == 5:
            frames[at] = (one, data[:rng.randrange(len(data) + 1)] + rng.randbytes(rng.randrange(3)))
        else:
            frames[at] = (one | rng.choice((REMOTE, ERROR)), data)
    return [(one, data, fd) for one, data in frames]


def can_traffic(rng, count):
    """[(bus, CAN id, data, FD)]: several messages at a time on several buses."""
    buses, share_fd = rng.randrange(1, 4), rng.choice((0, 0, 0.3, 1))
    running, traffic = [], []
    while len(traffic) < count:
        while len(running) < buses * 2:
            running.append((rng.randrange(buses), can_frames(rng, rng.random() < share_fd)))
        at = rng.randrange(len(running))
        bus, frames = running[at]
        if frames:
            traffic.append((bus, *frames.pop(0)))
        else:
            del running[at]
        if rng.random() < 0.02:
            traffic.append((bus, rng.getrandbits(32), rng.randbytes(rng.randrange(9)), False))
    return traffic


def stream(rng, count):
    """Pieces of a byte stream: frames, noise, and frames in which something is wrong."""
    for _ in range(count):
        kind = rng.random()
        if kind < 0.75:
            header, payload, crc = message(rng)
            frame = header + payload + struct.pack("<I", crc)
            if kind < 0.05:
                frame = frame[:rng.randrange(len(frame))]
            elif kind < 0.10:
                frame = frame[:8] + struct.pack("<H", rng.choice((0, 65535, rng.randrange(65536)))) + frame[10:]
            yield frame
        elif kind < 0.9:
            yield rng.choice((b"taurus> ", b"help\r\n", b"Y", b"YP", b"YPYPYP", b"\0" * 20, b"\x1b[2J", b"P"))
        else:
            yield rng.randbytes(rng.randrange(1, 40))


def pieces(rng, count):
    """A stream cut into packets."""
    data, at, packets = b"".join(stream(rng, count)), 0, []
    whole = rng.random() < 0.4
    if whole:
        return [piece for piece in stream(rng, count) if piece]
    longest = rng.choice((1, 8, 64, 300, 1400)) if count < 300 else rng.choice((8, 64, 300, 1400))
    while at < len(data):
        size = rng.randint(1, longest)
        packets.append(data[at:at + size])
        at += size
    return packets


# Carriers: rng, number of frames -> the packets [(interface, link type, bytes)] and tshark's arguments ---------------

def socketcan(rng, order, can_id, data, fd):
    length = rng.randrange(256) if rng.random() < 0.01 else len(data)
    flags = 4 | rng.randrange(4) if fd else rng.randrange(256) if rng.random() < 0.02 else 0
    if rng.random() < 0.1:
        data = data.ljust(64 if fd else 8, b"\0")
    return struct.pack(order + "I", can_id) + bytes((length, flags, 0, 0)) + data


def sll(rng, data, fd):
    return struct.pack(">HHH8xH", rng.choice((0, 4)), 280, 0, 0x0D if fd else 0x0C) + data


def sll2(rng, data, fd, bus):
    return struct.pack(">HHIHBB8x", 0x0D if fd else 0x0C, 0, bus, 280, rng.choice((0, 4)), 0) + data


def can_arguments(rng):
    return [["-d", "can.subdissector,yapp_all"]] if rng.random() < 0.2 else []


def can(rng, count):
    packets = [(bus, SOCKETCAN, socketcan(rng, ">", one, data, fd)) for bus, one, data, fd in can_traffic(rng, count)]
    return packets, can_arguments(rng)


def cooked_can(rng, count):
    link = rng.choice((SLL, SLL2))
    packets = []
    for bus, one, data, fd in can_traffic(rng, count):
        data = socketcan(rng, "<", one, data, fd)
        packets.append((bus, link, sll(rng, data, fd) if link == SLL else sll2(rng, data, fd, bus)))
    return packets, can_arguments(rng)


def user_dlt(rng, count):
    dlt = rng.randrange(16)
    table = f'uat:user_dlts:"User {dlt} (DLT={USER0 + dlt})","yapp_serial","0","","0",""'
    how = rng.choice((["-o", f"yapp.user_dlt:{USER0 + dlt}"], ["-o", table]))
    return [(0, USER0 + dlt, data) for data in pieces(rng, count)], [how]


def rtac(rng, count):
    packets = [(0, RTAC, struct.pack(">IIBBH", 1700000000, 0, rng.choice((1, 1, 2, 2, 3, 4, rng.randrange(256))), 0, 0)
                + data) for data in pieces(rng, count)]
    return packets, [["-d", "rtacser.data,yapp_serial"]]


def exported_pdu(rng, count):
    def tag(kind, value):
        return struct.pack(">HH", kind, len(value)) + value

    name = rng.choice(["yapp_serial"] * 6 + ["yapp", "taurus", "yapp_zero", "yapp_socketcan"])
    name = name.encode() + b"\0" * (4 - len(name) % 4)
    packets = []
    for data in pieces(rng, count):
        tags = tag(12, name)
        if rng.random() < 0.3:
            tags += tag(24, struct.pack(">I", rng.randrange(9))) + tag(25, struct.pack(">I", rng.randrange(3)))
        packets.append((0, PDU, tags + tag(0, b"") + data))
    return packets, []


def ip(rng, protocol, source, target, segment):
    flags = rng.choice((0x2000, 0x0001, 0x2001)) if rng.random() < 0.005 else 0
    header = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(segment), 1, flags, 64, protocol, 0)
    return header + bytes((192, 0, 2, source)) + bytes((192, 0, 2, target)) + segment


def in_ethernet(packets):
    return [(0, ETHERNET, bytes(12) + b"\x08\0" + data) for data in packets]


def decode_as(rng, table, ports):
    if rng.random() < 0.4:
        return []  # the heuristic
    return [["-d", f"{table}=={rng.choice(ports)},yapp_serial"]]


def udp(rng, count):
    """A conversation, now and then with a new port for each datagram; some datagrams are others'."""
    packets, changes, others = [], rng.random() < 0.2, rng.choice((0, 0, 0.3))
    for number, data in enumerate(pieces(rng, count)):
        a, b = (1, 2) if rng.random() < 0.7 else (2, 1)
        port = 40000 + number % 20000 if changes else 50000 + a
        data = rng.randbytes(rng.randrange(1, 30)) if rng.random() < others else data
        packets.append(ip(rng, 17, a, b, struct.pack(">HHHH", port, 50000 + b, 8 + len(data), 0) + data))
    return in_ethernet(packets), decode_as(rng, "udp.port", (50001, 50002))


def tcp(rng, count):
    """Several conversations; segments come twice, late, overlap or never.  Some servers are in telnet mode."""
    packets, is_telnet = [], rng.random() < 0.2
    while len(packets) < count:
        sequence, port = {1: rng.getrandbits(32), 2: rng.getrandbits(32)}, 50000 + rng.randrange(3)
        for data in pieces(rng, min(count, 200)):
            side = 1 if rng.random() < 0.8 else 2
            data = data.replace(b"\xff", b"\xff\xff") if is_telnet else data
            number = sequence[side]
            sequence[side] = number + len(data) & 0xFFFFFFFF
            kind = rng.random()
            if kind < 0.02:
                number = number - rng.randrange(50) & 0xFFFFFFFF
            elif kind < 0.04:
                continue
            ports = (port, 20001) if side == 1 else (20001, port)
            segment = struct.pack(">HHIIHHHH", *ports, number, sequence[3 - side], 0x5018, 65535, 0, 0) + data
            packets.append(ip(rng, 6, side, 3 - side, segment))
            if kind > 0.98:
                packets.append(packets[-1])
            elif kind > 0.96 and len(packets) > 1:
                packets[-2:] = packets[:-3:-1]
    return in_ethernet(packets), decode_as(rng, "tcp.port", (50000, 20001))


def usb(rng, count):
    """Adapters of several kinds, in usbmon or USBPcap; with or without their descriptors."""
    link, header = rng.choice(((USBMON_48, usbmon), (USBMON, usbmon), (USBPCAP, stream_captures.usbpcap)))
    size, packets = rng.choice((0, 0, 64, 512)), []
    vendor = rng.choice((None, 0x0403, 0x10C4, rng.randrange(65536)))
    if vendor is not None:
        descriptor = b"\x12\x01\0\x02\0\0\0\x40" + struct.pack("<H", vendor) + bytes(8)
        endpoint = b"\x07\x05\x81\x02" + struct.pack("<H", rng.choice((64, 512, 0, 1, 2, 65535))) + b"\0"
        packets = [header(2, 0x80, data, 7) for data in (descriptor, b"\x09\x02\x20\0\x01\x01\0\xa0\x2d" + endpoint)]
    for data in pieces(rng, count):
        inward = rng.random() < 0.7
        data = stream_captures.with_status(data, size) if size and inward else data
        packets.append(header(rng.choice((3,) * 9 + (1,)), 0x81 if inward else 2, data, 7))
    packets = [packet[:48] + packet[64:] for packet in packets] if link == USBMON_48 else packets
    return [(0, link, data) for data in packets], []


def mixed(rng, count):
    """All of them in one file, each on an interface of its own."""
    packets, arguments = [], []
    for maker in (can, cooked_can, user_dlt, rtac, exported_pdu, udp, tcp, usb):
        more, how = maker(rng, count // 8 + 1)
        packets += more
        arguments += how
    if rng.random() < 0.5:
        rng.shuffle(packets)
    return packets, arguments


# Files -----------------------------------------------------------------------------------------------------------

class Capture:
    """A file as its head and its units (records, lines, chunks), and the arguments to read it with, in groups."""

    def __init__(self, suffix, head, units, arguments):
        self.suffix, self.head, self.units, self.arguments = suffix, head, units, arguments

    def write(self, path, units=None):
        path.write_bytes(self.head + b"".join(self.units if units is None else units))
        path.chmod(0o644)


def damaged(rng, packets):
    """Packets [(interface, link type, bytes)] with what happens on the way: [(interface, link type, bytes, length)]."""
    rate = rng.choice((0, 0.01, 0.1, 0.5))
    snap = rng.choice((65535, 65535, 65535, 20, 30, 60))
    done = []
    for interface, link, data in packets:
        length = len(data)
        if rng.random() < rate:
            kind = rng.randrange(8)
            if kind < 3 and data:
                data = bytearray(data)
                for _ in range(rng.choice((1, 1, 2, 10))):
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
                data = bytes(data)
            elif kind == 3:
                data = data[:rng.randrange(len(data) + 1)]
                length = len(data)
            elif kind == 4:
                data = data[:rng.randrange(len(data) + 1)]
            elif kind == 5:
                data += rng.randbytes(rng.randrange(1, 30))
                length = len(data)
            elif kind == 6:
                done.append((interface, link, data, length))
            else:
                continue
        done.append((interface, link, data[:snap], length))
        if rng.random() < rate / 8 and len(done) > 1:
            at = rng.randrange(max(0, len(done) - 10), len(done))
            done[at], done[-1] = done[-1], done[at]
    return done


def times(rng, count):
    now = 1_700_000_000_000_000
    for _ in range(count):
        now += rng.randrange(1000)
        yield now if rng.random() < 0.999 else rng.choice((0, 2**51, now - 10**9))


def pcap(rng, packets, arguments):
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262144, packets[0][1] if packets else SOCKETCAN)
    units = [struct.pack("<IIII", now // 10**6 & 0xFFFFFFFF, now % 10**6, len(data), length) + data
             for (_, _, data, length), now in zip(packets, times(rng, len(packets)))]
    return Capture(".pcap", head, units, arguments)


def block(kind, body):
    body += b"\0" * (-len(body) % 4)
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def pcapng(rng, packets, arguments):
    interfaces = sorted({(link, interface) for interface, link, _, _ in packets})
    head = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    head += b"".join(block(1, struct.pack("<HHI", link, 0, 262144)) for link, _ in interfaces)
    number = {key: at for at, key in enumerate(interfaces)}
    flagged = rng.random() < 0.3  # with a direction

    def flags(data):
        value = struct.pack("<HHIHH", 2, 4, rng.choice((1, 1, 2, 2, 0, 3, rng.getrandbits(32))), 0, 0)
        return bytes(-len(data) % 4) + value if flagged else b""

    units = [block(6, struct.pack("<IIIII", number[link, interface], now >> 32, now & 0xFFFFFFFF, len(data), length)
                   + data + flags(data))
             for (interface, link, data, length), now in zip(packets, times(rng, len(packets)))]
    return Capture(".pcapng", head, units, arguments)


def packet_file(rng, count):
    maker = rng.choice((can, can, can, cooked_can, cooked_can, user_dlt, rtac, exported_pdu, udp, tcp, usb, mixed))
    packets, arguments = maker(rng, count)
    packets = damaged(rng, packets)
    links = {link for _, link, _, _ in packets}
    return (pcap if len(links) == 1 and rng.random() < 0.6 else pcapng)(rng, packets, arguments)


CANDUMP_STYLES = 5  # of candump_line


def candump_line(rng, style, now, bus, can_id, data, fd):
    name = f"can{bus}"
    ident = f"{can_id & 0x1FFFFFFF:08X}" if can_id & EXTENDED else f"{can_id & 0x7FF:03X}"
    if style < 2:
        body = f"#{rng.choice(('', f'#{rng.randrange(16):X}'))}{data.hex().upper()}" if fd else \
            "#81:00:12345678#112233" if rng.random() < 0.01 else \
            "#R" if can_id & REMOTE else f"#{data.hex().upper()}"
        return f"({now // 10**6}.{now % 10**6:06d}) {name} {ident}{body}" + (rng.choice((" R", " T")) if style else "")
    stamp = "" if style == 2 else f" ({now // 10**6}.{now % 10**6:06d})"
    if can_id & REMOTE:
        body = f"[{len(data)}]  remote request"
    else:
        body = f"[{len(data):02d}]" if fd else f"[{len(data)}]"
        body += "  " + data.hex(" ").upper() + ("   '........'" if style == 4 else "")
        body += "   ERRORFRAME" if can_id & ERROR else ""
    return f"{stamp}  {name}  {ident}   {body}"


def damaged_lines(rng, lines):
    rate = rng.choice((0, 0.01, 0.1, 0.3))
    done = []
    for line in lines:
        if rng.random() < rate:
            kind, at = rng.randrange(8), rng.randrange(len(line) + 1)
            if kind < 2:
                line = line[:at] + bytes((rng.randrange(256),)) + line[at + 1:]
            elif kind == 2:
                line = line[:at] + line[at + 1:]
            elif kind == 3:
                line = line[:at]
            elif kind == 4:
                done.append(line)
            elif kind == 5:
                line = line[:at] + line[at:] * rng.choice((2, 10))
            elif kind == 6:
                line = rng.choice((b"", b"# comment", b"interface can0 down", b"\t\t", b"(", b"DROPCOUNT: dropped 3 CAN"))
            elif rng.random() < 0.02:
                line += rng.choice((b"0", b" ", b"A5", line)) * 200_000
        done.append(line)
    return done


def candump_file(rng, count):
    style, lines = rng.randrange(CANDUMP_STYLES), []
    for frame, now in zip(can_traffic(rng, count), times(rng, count)):
        lines.append(candump_line(rng, style, now, *frame).encode())
    end = rng.choice((b"\n", b"\n", b"\r\n"))
    units = [line + end for line in damaged_lines(rng, lines)]
    arguments = [["-X", "read_format:yapp_candump"]]
    return Capture(rng.choice((".log", ".txt")), b"", units, arguments if rng.random() < 0.5 else [])


def asc_line(rng, now, bus, can_id, data, fd, dec):
    name = (f"{can_id & 0x1FFFFFFF:{'d' if dec else 'X'}}x" if can_id & EXTENDED else f"{can_id & 0x7FF:{'d' if dec else 'X'}}")
    words = " ".join(f"{byte:d}" if dec else f"{byte:02X}" for byte in data)
    stamp = f"{rng.choice(('', '', '-'))}{now // 10**6:4d}{rng.choice('..,')}{now % 10**6:06d}"
    direction = rng.choice(("Rx", "Rx", "Tx", "rx", "TX", "TxRq"))
    if can_id & ERROR:
        return f"{stamp} {bus + 1}  ErrorFrame"
    if fd:
        code = FD_LENGTHS.index(len(data)) if len(data) in FD_LENGTHS else 15
        return (f"{stamp} CANFD {bus + 1:3d} {direction} {name:>11} {rng.choice(('', 'a name'))} {rng.randrange(2)} "
                f"{rng.randrange(2)} {code:x} {len(data):2d} {words} 0 0 {rng.choice(('1000', '3000', '200010', 'x'))} 0 0 0 0 0")
    body = f"r {len(data):x}" if can_id & REMOTE else f"{rng.choice('ddD')} {len(data):x} {words}"
    if rng.random() < 0.02:
        return stamp + rng.choice((" 1  Statistic: D 1 R 0", " CAN 1 Status:chip status", " Start of measurement", " CANXL 2 Rx XLFF", " 1 J1939TP FEE3p"))
    return f"{stamp} {bus + 1}  {name:15} {direction}   {body}"


def asc_file(rng, count):
    """Vector's ASC, in hex or decimal, with absolute times or relative ones, in blocks."""
    dec, begin = rng.random() < 0.2, "Begin Triggerblock Tue Nov 14 22:13:20.001 2023"
    head = ["date " + rng.choice(("Tue Nov 14 10:13:20.001 pm 2023", "Die Nov 14 22:13:20 2023", "today", "")),
            f"base {'dec' if dec else 'hex'}  {rng.choice(('timestamps absolute', 'timestamps relative', 'no internal events logged'))}",
            "// version 7.1.0", begin]
    head = head[rng.choice((0, 0, 1)):]  # some programs leave out the date
    lines, now = [], 0
    for frame in can_traffic(rng, count):
        now += rng.randrange(1000)
        lines.append(asc_line(rng, now, *frame, dec).encode())
        if rng.random() < 0.001:
            lines += [b"End TriggerBlock", begin.encode()]
    end = rng.choice((b"\n", b"\r\n"))
    return Capture(".asc", end.decode().join([*head, ""]).encode(), [line + end for line in damaged_lines(rng, lines)], [])


def dump_file(rng, count):
    units = [piece for piece in stream(rng, count) if piece]
    if rng.random() < 0.5:
        units = [bytes(byte ^ (rng.random() < 0.01) << rng.randrange(8) for byte in unit) for unit in units]
    return Capture(".yapp", b"", units, [])


# The captures of the repository ------------------------------------------------------------------------------------

def split_pcap(data):
    head, at, units = data[:24], 24, []
    while at + 16 <= len(data):
        size = struct.unpack_from("<I", data, at + 8)[0]
        units.append(data[at:at + 16 + size])
        at += 16 + size
    return head, units


def split_pcapng(data):
    """The head has all interfaces."""
    head, units, at = b"", [], 0
    while at + 12 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        if size < 12:
            break
        if kind in (0x0A0D0D0A, 1):
            head += data[at:at + size]
        else:
            units.append(data[at:at + size])
        at += size
    return head, units


def split(suffix, data):
    if suffix == ".pcap":
        return split_pcap(data)
    if suffix == ".pcapng":
        return split_pcapng(data)
    if suffix in (".log", ".txt"):
        return b"", data.splitlines(keepends=True)
    return b"", [data[at:at + 64] for at in range(0, len(data), 64)]


TLS = CAPTURES / "cases/tls12_4433.pcapng"  # with its keys


@functools.lru_cache(None)
def corpus():
    kinds = (".pcap", ".pcapng", ".log", ".txt", ".yapp", ".bin")
    return sorted([TLS, *(path for kind in ("can", "serial", "candump") for path in (CAPTURES / kind).iterdir()
                          if path.suffix in kinds)])


def known_arguments(path):
    """The options that a capture of ours is read with, in groups."""
    if path == TLS:
        return [["-d", "tls.port==4433,yapp_serial"]]
    text = path.with_suffix(".frames")
    line = re.search(r"^options (.*)$", text.read_text(), re.M) if text.exists() else None
    words = shlex.split(line[1]) if line else []
    return [words[at:at + 2] for at in range(0, len(words), 2)]


def corpus_file(rng, count):
    path = rng.choice(corpus())
    head, units = split(path.suffix, path.read_bytes())
    units = (units * (min(count, 500) // max(1, len(units)) + 1))[:max(count, 1)]
    if path.suffix in (".log", ".txt"):
        units = damaged_lines(rng, units)
    else:
        rate, skip = rng.choice((0.05, 0.3)), {".pcap": 16, ".pcapng": 28}.get(path.suffix, 0)
        done = []
        for unit in units:
            kind = rng.random()
            if kind < rate and len(unit) > skip:
                unit = bytearray(unit)
                # Seldom a header of the file format: the rest would be lost.
                unit[rng.randrange(0 if kind < rate / 50 else skip, len(unit))] ^= 1 << rng.randrange(8)
            done += [] if kind > 0.98 else [bytes(unit)] * (2 if kind > 0.96 else 1)
        units = done
    return Capture(path.suffix, head, units, known_arguments(path))


def editcap_file(rng, count):
    """What Wireshark's own tool does to packets."""
    capture = packet_file(rng, count)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        capture.write(folder / "in")
        command = ["editcap", "-F", "pcapng", "-E", str(rng.choice((0.001, 0.01, 0.05))), "--seed",
                   str(rng.getrandbits(31)), folder / "in", folder / "out"]
        subprocess.run(command, capture_output=True, check=False)
        if (folder / "out").exists():
            head, units = split_pcapng((folder / "out").read_bytes())
            return Capture(".pcapng", head, units, capture.arguments)
    return capture


MAKERS = [packet_file] * 6 + [candump_file] * 2 + [asc_file, dump_file] + [corpus_file] * 4 + [editcap_file] * 2


def make(rng, longest):
    """A damaged file of 30 to so many frames, as often short as long: Capture."""
    return rng.choice(MAKERS)(rng, int(10 ** rng.uniform(1.5, math.log10(longest))))
