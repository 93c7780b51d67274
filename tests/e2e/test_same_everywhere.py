# SPDX-License-Identifier: GPL-2.0-or-later
"""What a frame is depends on nothing that is asked for: not on fields, filters and passes, not on what other layers show."""
import functools
import random
import re
import shutil

import pytest

import can_generator
import capture_file
import flights
import levels
import tshark
from can_generator import Frame, Sent

pytestmark = levels.by_version
COMMAND = bytes.fromhex("015A014F80F380")
MOTOR = bytes(range(1, 33))
EVERY_PASS = [(), ("-2",), ("-2", "-R", "frame"), ("-2", "-Y", "frame"), ("-Y", "frame")]
PASSES = levels.few(EVERY_PASS, EVERY_PASS[:3])
NAMED = [(), ("can.id",), ("can.flags.xtd",), ("can.id", "can.flags.xtd"), ("can.len",), ("frame.interface_id",)]


def remote(can_id, length):
    return Frame(can_id, bytes(length), kind="remote")


def shown(path, *names, passes=(), named=()):
    rows = tshark.fields(path, [*names, *named], *passes)
    return [row[:len(names)] for row in rows]


def written(folder, frames, layout="plain"):
    path = folder / "frames.pcapng"
    can_generator.write(path, frames, layout)
    return path


@levels.each_once
@pytest.mark.parametrize("named", NAMED, ids=" ".join)
@pytest.mark.parametrize("passes", PASSES, ids=" ".join)
def test_fields_that_are_named_change_nothing(passes, named, folder):
    """Remote frames are told by fields of SocketCAN, where there are any."""
    asks = [remote(0, 7), remote(0, 7)] if "-2" not in passes else [Frame(0x123, bytes(7), kind="standard")] * 2
    frames = [Sent(0, 0, 0, COMMAND).frame(0, COMMAND), *asks, Sent(0, 0, 0, COMMAND).frame(0, COMMAND),
              *Sent(0x210, 0, 0, MOTOR).frames(), *Sent(0x123, 0, 0, MOTOR).frames(), *asks]
    rows = shown(written(folder, frames), "yapp.id", "yapp.crc.status", passes=passes, named=(*named, *tshark.tells_remote()))
    ids = ["0x00000000", "", "", "0x00000000"] + ["0x00000210"] * 5 + ["0x00000123"] * 5 + ["", ""]
    assert [row[0] for row in rows] == ids
    assert [at for at, row in enumerate(rows) if row[1] == "1"] == [8, 13]


def stray_end(buses):
    """Start and Middles on one bus, the End on another."""
    frames = Sent(0x210, 0, 0, MOTOR).frames()
    for frame, bus in zip(frames, buses):
        frame.bus = bus
    return frames


def pcapng_file(path, linktypes, frames):
    path.write_bytes(capture_file.section(*map(capture_file.interface, linktypes)) + b"".join(
        capture_file.packet(number, frame.record() if linktypes[frame.bus] == capture_file.SOCKETCAN else
                            capture_file.sll(frame.record(little=True), frame.fd), frame.bus) for number, frame in enumerate(frames)))


@levels.each_once
@pytest.mark.parametrize("passes", PASSES, ids=" ".join)
@pytest.mark.parametrize("kind", ["IP first", "IP for long", "SLL", "SocketCAN and SLL"])
def test_buses_never_mix(kind, passes, folder):
    """However late and whichever way the file tells that there are several."""
    path, frames = folder / "two.pcapng", stray_end([0, 0, 0, 0, 1])
    before = {"IP first": 1, "IP for long": 2000}.get(kind, 0)
    if before:
        can_generator.write_behind_ip(path, before, frames)
    else:
        cooked = capture_file.SLL
        pcapng_file(path, [cooked if kind == "SLL" else capture_file.SOCKETCAN, cooked], frames)
    # With some fields named only, later versions have no more: those that say the bus are named too.
    rows = shown(path, "yapp.fragment.orphan", "yapp.crc.status", passes=passes, named=["sll.ifindex", "frame.interface_id"])
    assert len(rows) == before + 5 or passes[-2:] == ("-R", "frame")
    assert bool(rows[-1][0]) and rows[-1][1] == ""


def test_decode_as_in_two_passes_loses_the_first_message_and_says_so(folder):
    """A first pass of two does not know the id of the first frame.  The preference has no such gap."""
    path = written(folder, Sent(0x300, 2, 0, MOTOR).frames() * 2)
    names = ["yapp.crc.status", "yapp.fragment.orphan"]
    found = [(bool(crc), bool(orphan)) for crc, orphan in shown(path, *names, passes=("-2", "-d", "can.subdissector,yapp_all"))]
    assert found[1:5] == [(False, True)] * 4 and found[5:] == [(False, False)] * 4 + [(True, False)]
    assert [crc for crc, _ in shown(path, *names, passes=("-2", *can_generator.EVERY_EXTENDED))] == ["", "", "", "", "1"] * 2


INFO = "_ws.col.Info" if tshark.version() < (4, 2) else "_ws.col.info"
LINK = re.compile(r"  \[Reassembled in #\d+\]| fragment \d+( of \d+)?| started in frame \d+")


def traffic(seed):
    """Messages of several kinds that interleave; some lose a frame."""
    rng = random.Random(seed)
    streams = []
    for msg, size in ((0x210, 32), (0x124, 32), (0x200, 17), (0, 7), (0x123, 60)):
        frames = []
        for _ in range(12):
            message = Sent(msg, 0, 0, bytes(rng.randrange(1, 200) for _ in range(size))).frames()
            if len(message) > 1 and rng.random() < 0.2:
                del message[rng.randrange(len(message))]
            frames += message
        streams.append(frames)
    return can_generator.merge(rng, streams)


# What is taken back when a message comes out good is still said in one pass.
TOLD = [INFO, "yapp.crc.status", "taurus.motor.timestamp", "yapp.time_delta", "yapp.fragment.orphan", "yapp.fragment.incomplete"]


@functools.lru_cache(None)
def shown_without_a_read_filter(seed):
    folder = tshark.writable_folder()
    try:
        return shown(written(folder, traffic(seed)), *TOLD, passes=("-2",))
    finally:
        shutil.rmtree(folder)


@levels.each_once
@pytest.mark.parametrize("read_filter", levels.few([
    "yapp.id == 0 || yapp.id == 0x200", "yapp.can.ctrl == 1", "yapp.can.ctrl == 2", "yapp.can.ctrl == 3", "taurus",
    "not yapp.can.ctrl == 1", "not yapp.can.ctrl == 2", "not taurus", "yapp.crc.status == 1"],
    ["yapp.id == 0 || yapp.id == 0x200", "yapp.can.ctrl == 2", "not yapp.can.ctrl == 1", "taurus"]))
@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_read_filter_leaves(seed, read_filter, folder):
    """It takes frames of messages away, and their numbers are the next ones'; what is left shows what it always shows."""
    path = written(folder, traffic(seed))
    numbers = [number for number, in tshark.fields(path, ["frame.number"], "-2", "-Y", read_filter)]
    every = shown_without_a_read_filter(seed)
    left = shown(path, *TOLD, "yapp.fragment", passes=("-2", "-R", read_filter))
    assert 0 < len(left) < len(every)
    for now, (row, number) in enumerate(zip(left, numbers, strict=True), 1):
        assert [LINK.sub("", text) for text in row[:-1]] == [LINK.sub("", text) for text in every[int(number) - 1]], number
        assert all(int(other) <= now for other in row[-1].split(",") if other)


@levels.each_once
@pytest.mark.parametrize("passes", PASSES, ids=" ".join)
@pytest.mark.parametrize("layout", ["plain", "sll"])
@pytest.mark.parametrize("ids", [1, 200])
def test_others_throw_at_frames_that_the_capture_cut(ids, layout, passes, folder):
    """AUTOSAR NM is asked first and takes CAN ids below 0x100.  Each time that it throws past Lua costs 2 of Lua's 200 nested
    calls."""
    ours = Sent(0x210, 0, 0, MOTOR).frames()
    cut = [Frame(number % ids, bytes(range(1, 9)), captured=6) for number in range(300)]
    path = written(folder, [Frame(0x300 << 18, bytes(4)), *cut, *ours], layout)
    found = shown(path, "yapp.crc.status", "autosar-nm", passes=(
        *passes, "-d", "can.subdissector,yapp_all", "-o", "can.try_heuristic_first:TRUE",
        "-o", "autosar-nm.can_id_mask:0xffffff00"))
    assert [row[0] for row in found] == [""] * 305 + ["1"]
    assert [bool(row[1]) for row in found] == [False] + [True] * 300 + [False] * 5


@pytest.mark.skipif(tshark.version() < (4, 2), reason="no filter names a column")
@pytest.mark.parametrize("name", ["can/document_motor.pcap", "serial/document_uart_split.pcap"])
def test_a_first_pass_that_has_columns(name):
    """They are there for a filter that names one."""
    def found(*options):
        return tshark.fields(tshark.CAPTURES / name, ["frame.number", "taurus.motor.dc_voltage"], "-2", *options)

    rejecting = found("-R", '_ws.col.info contains "Motor"')
    assert [row[1] for row in rejecting if row[1]] == ["47.97314"]
    assert found("-Y", 'yapp.crc.status && _ws.col.protocol == "YAPP"') == found("-Y", "yapp.crc.status") != []
    assert found("-Y", 'yapp.reassembled.in && _ws.col.protocol == "YAPP"') == found("-Y", "yapp.reassembled.in")


@pytest.mark.parametrize("passes", PASSES, ids=" ".join)
def test_several_can_frames_in_a_packet(passes, folder):
    motor, command = Sent(0x210, 0, 0, MOTOR).frames(), Sent(0, 0, 0, COMMAND).frame(0, COMMAND)
    packets = [[*motor, command], motor[:3], [*motor[3:], command, command], [command], motor]
    path = folder / "acf.pcap"
    path.write_bytes(capture_file.pcap(1, [(number, flights.acf_can(*one)) for number, one in enumerate(packets)]))
    rows = shown(path, "yapp.id", "yapp.crc.status", "yapp.fragment", "yapp.reassembled.in",
                 "yapp.fragment.orphan", "yapp.size.mismatch", passes=passes)
    motor_id, command_id = "0x00000210", "0x00000000"
    assert [row[0].split(",") for row in rows] == [
        [motor_id] * 5 + [command_id], [motor_id] * 3, [motor_id] * 2 + [command_id] * 2, [command_id], [motor_id] * 5]
    assert [row[1:3] for row in rows] == [["1", "1,1,1,1,1"], ["", ""], ["1", "2,2,2,3,3"], ["", ""], ["1", "5,5,5,5,5"]]
    if "-2" in passes:
        assert [row[3] for row in rows] == ["1,1,1,1,1", "3,3,3", "3,3", "", "5,5,5,5,5"]
    assert not any(row[4] or row[5] for row in rows)


@levels.each_once
@pytest.mark.parametrize("passes", PASSES, ids=" ".join)
@pytest.mark.parametrize("arguments", [("-d", "can.subdissector,yapp_all"), can_generator.EVERY_EXTENDED, ()],
                         ids=["Decode As", "all", "default"])
def test_ids_in_the_byte_order_of_the_machine(arguments, passes, folder):
    """Old captures have them so; a preference of SocketCAN says it."""
    frames = [*Sent(0x210, 0, 0, MOTOR).frames(), *Sent(0x123, 0, 0, MOTOR).frames()]
    records = [(number, frame.record(little=True)) for number, frame in enumerate(frames)]
    (folder / "swapped.pcap").write_bytes(capture_file.pcap(capture_file.SOCKETCAN, records))
    rows = shown(folder / "swapped.pcap", "yapp.id", "yapp.crc.status", passes=(*passes, *arguments, "-o", "can.byte_swap:TRUE"))
    assert rows == [["0x00000210", ""]] * 4 + [["0x00000210", "1"]] + [["0x00000123", ""]] * 4 + [["0x00000123", "1"]]
