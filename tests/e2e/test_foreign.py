# SPDX-License-Identifier: GPL-2.0-or-later
"""Everybody else's traffic: with the plugin, tshark -V says the same as without, byte for byte.

The frames are made from a seed.  Random extended frames may be well-formed YAPP: can_generator.verdicts says which, and only
these may differ.
"""
import os
import random
import re
import struct

import pytest

import can_generator
import capture_file
import levels
import tshark
from can_generator import Frame

SEED = os.environ.get("YAPP_SEED", "1")
COUNT = 400


# Other protocols on CAN --------------------------------------------------------------------------------------------

def j1939(rng):
    """Engine speed, temperatures, diagnostics, address claims, and transport: announced, then in packets."""
    frames = []
    while len(frames) < COUNT:
        source = rng.randrange(254)
        pgn, priority = rng.choice([(0xF004, 3), (0xFEEE, 6), (0xFEF1, 6), (0xFECA, 6), (0xEEFF, 6), (0xEA00, 6),
                                    (0xFF00 + rng.randrange(256), 6), (0x0100, 3)])
        can_id = priority << 26 | pgn << 8 | source
        if pgn == 0xFECA:
            size = rng.randrange(9, 60)
            frames.append(Frame(0x1CECFF00 | source, bytes([0x20]) + struct.pack("<HB", size, -(-size // 7)) +
                                bytes([0xFF, 0xCA, 0xFE, 0])))
            data = rng.randbytes(size).ljust(-(-size // 7) * 7, b"\xFF")
            frames += [Frame(0x1CEBFF00 | source, bytes([at // 7 + 1]) + data[at:at + 7])
                       for at in range(0, len(data), 7)]
        elif pgn == 0xEA00:
            frames.append(Frame(can_id | 0xFF00, bytes([0xEB, 0xFE, 0])))
        else:
            frames.append(Frame(can_id, rng.randbytes(rng.randrange(1, 8)).ljust(8, b"\xFF")))
    return frames


def remote_and_error(rng):
    """Remote frames on the very IDs of YAPP, with the zeros that some tools record, and without data; error frames."""
    frames = []
    for msg in (0x000, 0x200, 0x210, 0x123):
        for ctrl in range(4):
            for length in range(9):
                for kind in ("remote", "error"):
                    frames.append(Frame(msg << 18 | ctrl << 14, bytes(length), kind=kind))
    frames += [Frame(rng.getrandbits(29), bytes(rng.randrange(9)), kind="remote") for _ in range(200)]
    frames += [Frame(rng.getrandbits(11), rng.randbytes(rng.randrange(9)), kind="standard") for _ in range(200)]
    frames += [Frame(1 << rng.randrange(9), rng.randbytes(8), kind="error") for _ in range(200)]
    return frames


def random_extended(rng):
    """Any id, any length; a good part near the ids that YAPP uses."""
    frames = []
    for _ in range(COUNT):
        can_id = rng.getrandbits(29)
        if rng.random() < 0.5:
            can_id = rng.choice([0, 0x200, 0x210, 0x123, rng.getrandbits(11)]) << 18 | rng.getrandbits(18)
        if rng.random() < 0.3:
            can_id &= ~0x3F00  # YAPP CTL 0
        data = rng.randbytes(rng.randrange(9))
        if len(data) == 8 and rng.random() < 0.3:
            data = data[:5] + bytes(3)
        frames.append(Frame(can_id, data))
    return frames


TRAFFIC = {
    "J1939": (j1939, []),
    "J1939, Decode As": (j1939, ["-d", "can.subdissector,j1939"]),
    "remote and error frames": (remote_and_error, []),
    "random extended": (random_extended, []),
    "random extended, Decode As": (random_extended, ["-d", "can.subdissector,j1939"]),
}


def details(path, plugin, *arguments):
    """What -V says of each packet."""
    done = tshark.run("-r", path, "-V", *arguments, plugin=plugin)
    return re.split(r"(?m)^(?=Frame \d+:)", done.stdout)[1:]


def differing(path, *arguments):
    """The frames that look different with the plugin."""
    without, with_plugin = details(path, False, *arguments), details(path, True, *can_generator.PREFERENCES, *arguments)
    assert len(without) == len(with_plugin) > 0
    return {number for number, (a, b) in enumerate(zip(without, with_plugin), 1) if a != b}


def ours(frames):
    """The frames that are well-formed YAPP."""
    return {number for number, verdict in can_generator.verdicts(frames, False).items() if verdict.ours}


@pytest.mark.parametrize("name", levels.few(TRAFFIC, [name for name in TRAFFIC if "Decode As" in name]))
def test_can(name, folder, monkeypatch):
    make, arguments = TRAFFIC[name]
    if name == "random extended, Decode As":  # J1939 asks for no bytes of a frame without data: a bug of Wireshark's, told as such
        monkeypatch.delenv("WIRESHARK_ABORT_ON_DISSECTOR_BUG", raising=False)
    frames = make(random.Random(f"{SEED} {name}"))
    path = folder / "foreign.pcap"
    can_generator.write(path, frames, "plain")
    expected = ours(frames)
    assert not expected or name.startswith("random"), f"frame {min(expected)} of the test is YAPP"
    assert differing(path, *arguments) == expected


FORMS = [("plain", ["-2"]), ("sll2", []), ("sll", []), ("interfaces", [])]


@pytest.mark.parametrize("form, passes", levels.few(FORMS, FORMS[:2], several=True))
def test_all_together(form, passes, folder):
    rng = random.Random(SEED)
    frames = can_generator.merge(rng, [make(rng) for make in dict(TRAFFIC.values())])
    path = folder / "foreign"
    if "-2" in passes:  # nothing tells remote frames from data in a first pass of two
        frames = [frame for frame in frames if frame.kind != "remote"]
    can_generator.write(path, frames, form)
    assert differing(path, *passes) == ours(frames)


# Ethernet ----------------------------------------------------------------------------------------------------------

def internet_packets(rng):
    """UDP and TCP: random payloads, text, and much that begins like a YAPP frame, but with a header that no message has."""
    packets, sequence = [], 1
    for number in range(600):
        text = rng.choice([b"", b"YP", b"hello YP " * 3, b"GET / HTTP/1.1\r\nHost: YP\r\n\r\n",
                           *(b"YP" + struct.pack("<BBIHH", 0, 0, *head) for head in [(0x8210, 32, 0), (0x10211, 32, 0), (0x210, 32, 1)])])
        payload = text + rng.randbytes(rng.randrange(60)) + rng.choice([b"", text])
        ports = struct.pack(">HH", rng.choice([40000, 40001, 53]), rng.choice([41000, 7000]))
        if number % 2:
            body = ports + struct.pack(">HH", 8 + len(payload), 0) + payload
        else:
            body = ports + struct.pack(">IIBBHHH", sequence, 1, 0x50, 0x18, 8192, 0, 0) + payload
            sequence += len(payload)
        head = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), number, 0, 64, 17 if number % 2 else 6, 0,
                           bytes([10, 0, 0, 1]), bytes([10, 0, 0, 2]))
        packets.append(bytes(12) + b"\x08\0" + head + body)
    return packets


def test_ethernet(folder):
    path = folder / "internet.pcap"
    packets = internet_packets(random.Random(f"{SEED} internet"))
    path.write_bytes(capture_file.pcap(1, [(1_700_000_000_000_000 + number * 1000, packet) for number, packet in enumerate(packets, 1)]))
    for passes in levels.size([["-2"]], [["-2"], []]):
        assert differing(path, *passes) == set()
