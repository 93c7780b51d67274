# SPDX-License-Identifier: GPL-2.0-or-later
"""The benchmark's traffic: the same bytes each time.  A message is 32 bytes of Motor Data, one in fifty with a fault.

yapp.pcap     YAPP on SocketCAN, five frames a message
yapp.log      the same as a candump log
isotp.pcap    the same bytes as ISO-TP, also five frames a message
udp.pcap      plain Ethernet and UDP, as many packets as yapp.pcap has frames
uart.pcap     the same messages as a serial stream, in packets of 64 bytes
one.pcap      one frame of YAPP
two_buses.pcapng  on two, their frames in turns
"""
import itertools
import random
import struct

import capture_file
from crc32k import crc32k

FRAMES = 5  # of a message, on CAN
FAULT_EVERY = 50
MOTOR_DATA = struct.Struct("<6HBBIIqBB")
OVERCURRENT = 0x10000
START, MIDDLE, END, ISOTP = 0x08404000, 0x08408000, 0x0840C000, 0x18DA10F1  # CAN ids
SOCKETCAN, ETHERNET, EXPORTED_PDU = 227, 1, 252
DATAGRAM = (bytes(12) + b"\x08\0" + bytes.fromhex("450000480000400040110000c0a8010ac0a80114") +
            struct.pack(">HHHH", 40000, 40001, 52, 0))
FOR_YAPP = struct.pack(">HH12sHH", 12, 12, b"yapp_serial", 0, 0)  # the tags of an exported PDU
UART_PACKET = 64
BEGIN, BETWEEN = 1_700_000_000_000_000, 200  # microseconds


def messages(count):
    rng = random.Random(1)
    for i in range(count):
        yield MOTOR_DATA.pack(*(rng.randrange(65531) for _ in range(6)), rng.randrange(251), 1, 0x00110000,
                              OVERCURRENT if i % FAULT_EVERY == 0 else 0, i * 100_000_000, 3, rng.randrange(251))


def sealed(payload):
    """A serial frame: header, payload, CRC."""
    data = b"YP" + struct.pack("<BBIHH", 0, 0, 0x210, len(payload), 0) + payload
    return data + struct.pack("<I", crc32k(data))


def yapp_frames(payload):
    yield START, sealed(payload)[-4:] + struct.pack("<HH", len(payload), 0)
    for at in range(0, len(payload), 8):
        yield (END if at + 8 >= len(payload) else MIDDLE), payload[at:at + 8]


def isotp_frames(payload):
    yield ISOTP, struct.pack(">H", 0x1000 | len(payload)) + payload[:6]
    for n, at in enumerate(range(6, len(payload), 7), 1):
        yield ISOTP, bytes([0x20 | n & 15]) + payload[at:at + 7]


def can_packets(count, frames):
    for payload in messages(count):
        for can_id, data in frames(payload):
            yield struct.pack(">IBxxx", can_id | 0x80000000, len(data)) + data.ljust(8, b"\0")


def unknown_packets(count, ids):
    """The messages under so many IDs in turns, from 0x020 on; two of 2,000 are known."""
    for number, payload in enumerate(messages(count)):
        shift = 0x20 + number % ids
        for can_id, data in yapp_frames(payload):
            yield struct.pack(">IBxxx", can_id & 0x3FFFF | shift << 18 | 0x80000000, len(data)) + data.ljust(8, b"\0")


def datagrams(count):
    rng = random.Random(1)
    for _ in range(count * FRAMES):
        yield DATAGRAM + rng.randbytes(44)


def uart_packets(count):
    waiting = b""
    for payload in messages(count):
        waiting += sealed(payload)
        while len(waiting) >= UART_PACKET:
            yield FOR_YAPP + waiting[:UART_PACKET]
            waiting = waiting[UART_PACKET:]
    if waiting:
        yield FOR_YAPP + waiting


def write_pcap(path, linktype, packets):
    path.write_bytes(capture_file.pcap(linktype, ((BEGIN + BETWEEN * number, data) for number, data in enumerate(packets, 1))))


def write_log(path, count):
    time = BEGIN
    with open(path, "w", encoding="ascii") as file:
        for payload in messages(count):
            for can_id, data in yapp_frames(payload):
                time += BETWEEN
                file.write(f"({time // 1_000_000}.{time % 1_000_000:06d}) can0 {can_id:08X}#{data.hex().upper()}\n")


def in_turns(packets):
    """The frames of two messages in turns, as two buses send them: (bus, packet)."""
    packets = iter(packets)
    while pair := list(itertools.islice(packets, 2 * FRAMES)):
        for at in range(FRAMES):
            yield from ((bus, pair[at + bus * FRAMES]) for bus in (0, 1) if at + bus * FRAMES < len(pair))


def write_pcapng(path, names, packets):
    """packets: (interface, bytes)."""
    path.write_bytes(capture_file.section(*(capture_file.interface(SOCKETCAN, name) for name in names)) + b"".join(
        capture_file.packet(BEGIN + BETWEEN * number, data, bus) for number, (bus, data) in enumerate(packets, 1)))


WRITERS = {
    "yapp.pcap": lambda path, count: write_pcap(path, SOCKETCAN, can_packets(count, yapp_frames)),
    "isotp.pcap": lambda path, count: write_pcap(path, SOCKETCAN, can_packets(count, isotp_frames)),
    "udp.pcap": lambda path, count: write_pcap(path, ETHERNET, datagrams(count)),
    "uart.pcap": lambda path, count: write_pcap(path, EXPORTED_PDU, uart_packets(count)),
    "one.pcap": lambda path, count: write_pcap(path, SOCKETCAN, list(can_packets(1, yapp_frames))[:1]),
    "two_buses.pcapng": lambda path, count: write_pcapng(path, ["can0", "can1"], in_turns(can_packets(count, yapp_frames))),
    "yapp.log": write_log,
}


def make(folder, count, names=tuple(WRITERS)):
    """Writes the files of so many messages into a folder, which is made; returns the folder."""
    folder.mkdir(exist_ok=True)
    for name in names:
        WRITERS[name](folder / name, count)
    return folder
