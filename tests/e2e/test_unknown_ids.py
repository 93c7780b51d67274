# SPDX-License-Identifier: GPL-2.0-or-later
"""IDs that are not in the catalogue: the plugin registers their CAN ids as their Seq Nos come."""
import struct

import pytest

import can_generator
import tshark

def write(path, messages):
    """A capture of messages of 32 bytes: [(ID, Seq No)]."""
    can_generator.write(path, [frame for number, (ident, seq) in enumerate(messages)
                               for frame in can_generator.Sent(ident, 0, seq, struct.pack("<I", number) * 8).frames()], "plain")
    return path


def shown(path, *arguments):
    """[(ID, Seq No)] of the messages that tshark shows whole."""
    rows = tshark.fields(path, ["yapp.id", "yapp.seq"], "-Y", "yapp.reassembled.data", *arguments)
    return [(int(ident, 0), int(seq)) for ident, seq in rows]


@pytest.mark.parametrize("two", [(), ("-2",)], ids=["one pass", "two passes"])
def test_seq_nos(tmp_path, two):
    """All and round; not numbered; many missing; late ones: each of two IDs of its own, in turns."""
    sequences = [*range(256), 0, 1], [0] * 5, [0, 1, 200, 90, 7, 255], [0, 32, 5, 31, 64]
    messages = [(base + ident, seq) for base, sequence in enumerate(sequences) for seq in sequence for ident in (0x123, 0x456)]
    messages += [(0x300 + ident, seq) for ident in range(80) for seq in (0, 1, 200)]  # more than have all Starts registered at once
    assert shown(write(tmp_path / "unknown.pcap", messages), *two) == messages


def test_an_id_that_does_not_begin_with_0_waits_for_it(tmp_path):
    messages = [(0x123, seq) for seq in (254, 255, 0, 1)]
    assert shown(write(tmp_path / "unknown.pcap", messages)) == messages[2:]


@pytest.mark.parametrize("passes", [(), ("-2",)])
def test_a_frame_that_another_dissector_takes(passes):
    """A Command of 8 bytes is AUTOSAR's to a heuristic of Wireshark's; with Decode As it is YAPP's, and counts once."""
    path = tshark.CAPTURES / "can/wrong_size.pcap"
    for options, size in ([], "0x0 (8 bytes, Command has 7); 0x210 (31 bytes, Motor Data has 32)"), (["-d", "can.subdissector,yapp_all"], "1 message was decoded in part: 0x0 (8"):
        assert size in tshark.run(*passes, *options, "-r", path, "-q", "-z", "yapp,faults", check=False).stdout
