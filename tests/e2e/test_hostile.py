# SPDX-License-Identifier: GPL-2.0-or-later
"""Input that is meant to harm: sizes and lengths at their ends, preferences, candump lines.  Time and memory
stay bounded, the words say what is wrong and where, and what is good is still decoded."""
import pathlib
import resource
import struct

import pytest

import levels
import make
import test_preferences as given
import tshark

MEMORY = 2 * 2**30  # address space; a plain run takes a quarter
SECONDS = 60  # of CPU; a plain run takes half of one


def limits():
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def decoded_and_said(path, *arguments, passes=((), ("-2",)), **options):
    """The numbers of the frames with a Taurus message, the same in one pass and in two, with no error in Lua in either;
    and what the plugin says on stderr in the last one."""
    found = []
    for two in passes:
        done = tshark.run(*two, *arguments, "-r", path, "-T", "fields", "-e", "frame.number", "-e", "_ws.lua.error",
                          "-e", "taurus.command.key", "-e", "taurus.motor.fault_flags", limits=limits, **options)
        assert "Dissector bug" not in done.stderr
        rows = [line.split("\t") for line in done.stdout.splitlines()]
        assert [row for row in rows if row[1]] == []
        found.append([int(row[0]) for row in rows if row[2] or row[3]])
    assert all(one == found[0] for one in found)
    return found[0], ours(done.stderr)


def decoded(path, *arguments, **options):
    return decoded_and_said(path, *arguments, **options)[0]


def ours(stderr):
    return [line for line in stderr.splitlines() if line.startswith(("yapp: ", "candump reader: "))]


def said(*arguments, **options):
    """What the plugin says on stderr."""
    return ours(tshark.run(*arguments, limits=limits, **options).stderr)


# Sizes and lengths -------------------------------------------------------------------------------------------------

SIZES = (0, 1, 7, 8, 9, 31, 33, 255, 256, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF)


def start(ident, size, reserved=0):
    """A Start with this size."""
    return f"can0 {ident << 18 | 1 << 14:08X} {struct.pack('<IHH', 0xC76FBEBB, size, reserved).hex(' ')}"


def frame(ident, ctrl, data="00*8"):
    return f"can0 {ident << 18 | ctrl << 14:08X} {data}"


@pytest.mark.parametrize("arguments", levels.few(
    [(), ("-o", "yapp.all_extended:TRUE"), ("-d", "can.subdissector,yapp_all")], [("-d", "can.subdissector,yapp_all")]),
                         ids=["default", "all_extended", "decode_as"])
def test_sizes_that_a_start_announces(folder, arguments):
    """A message of any size with nothing, too little, or too much; the message after them is decoded."""
    lines = []
    for size in SIZES:
        for ident in (0x210, 0x123):
            lines += [start(ident, size), start(ident, size, 0xFFFF), frame(ident, 2), frame(ident, 2, ""),
                      frame(ident, 3), start(ident, size), *[frame(ident, 2)] * 5, frame(ident, 3),
                      start(ident, size), frame(ident, 3)]
    lines.append(f"can0 [210 {given.MOTOR}]")
    path = given.write(folder, *lines)
    assert decoded(path, *arguments)[-1] == len(lines) + 4


@levels.deep
def test_starts_without_end(folder):
    """A Start of 65,535 bytes for each message ID, again and again."""
    lines = [start(ident, 0xFFFF) for ident in range(1, 2048)] * 10
    path = given.write(folder, *lines, f"can0 [210 {given.MOTOR}]")
    assert decoded(path) == [len(lines) + 5]


@levels.deep
def test_the_longest_messages(folder):
    """65,535 bytes in frames of 8: all of it arrives."""
    count = 3
    lines = [f"can0 [123 {'5A*65535'}]"] * count
    path = given.write(folder, *lines, f"can0 [210 {given.MOTOR}]")
    assert len(decoded(path, "-o", "yapp.all_extended:TRUE")) == 1
    done = tshark.run("-r", path, "-Y", "yapp.crc.status == 1 && yapp.reassembled.length == 65535", limits=limits)
    assert len(done.stdout.splitlines()) == count


HEADERS = {
    "announced sizes": b"YP" + struct.pack("<BBIHH", 0, 0, 0x210, 0xFFFF, 0),
    "sync alone": b"YP",
    "half a sync": b"Y",
    "size 0": b"YP" + struct.pack("<BBIHH", 0, 0, 0x210, 0, 0),
    "unknown ids": b"YP" + struct.pack("<BBIHH", 0, 0, 0xFFFFFFFF, 0xFFFF, 0xFFFF),
}


@levels.by_version
@pytest.mark.parametrize("name", levels.few(HEADERS, ["announced sizes"]))
def test_a_serial_dump_of_headers(folder, name):
    """A megabyte in which each header says that 65,535 bytes follow; and the frame at its end."""
    header = HEADERS[name]
    path = folder / "headers.yapp"
    message = {"id": 0x210, "seq": 0, "ctl": 0, "payload": bytes.fromhex(given.MOTOR), "wrong_crc": False}
    good = make.serial_frame(message)
    path.write_bytes(good + header * (2**20 // len(header)) + good)
    for two in ((), ("-2",)):
        done = tshark.run(*two, "-r", path, "-Y", "taurus.motor || _ws.lua.error", "-T", "fields", "-e",
                          "taurus.motor.rpm_measured", "-e", "_ws.lua.error", limits=limits)
        assert [line.endswith("\t") for line in done.stdout.splitlines()] == [True, True]


def socketcan(can_id, length, flags, data):
    return struct.pack(">IBBH", can_id, length, flags, 0) + data


# Each length has records of these ids with so many bytes, and a message behind them.
LENGTHS = [0, 1, 7, 9, 15, 16, 64, 65, 128, 254, 255]
HEADS = [(can_id, size) for can_id in (0, 0x08400000, 0x08404000, 0x08408000, 0x0840C000) for size in (0, 1, 7, 8, 64)]


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("arguments", [(), ("-o", "yapp.all_extended:TRUE"), ("-d", "can.subdissector,yapp_all")],
                         ids=["default", "all_extended", "decode_as"])
@pytest.mark.parametrize("flags", [0, 4], ids=["can", "fd"])
def test_lengths_above_the_record(folder, flags, arguments):
    """The length of a SocketCAN header says more, or less, than the record has."""
    records = []
    for length in LENGTHS:
        records += [socketcan(0x80000000 | can_id, length, flags, b"\xA5" * size) for can_id, size in HEADS]
        records.append(socketcan(0x80000000, 7, 0, bytes.fromhex("015A014F80F380")))
    path = folder / "lengths.pcap"
    path.write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227) + b"".join(
        struct.pack("<IIII", at, 0, len(one), len(one)) + one for at, one in enumerate(records)))
    each = len(HEADS) + 1
    assert set(range(each, len(records) + 1, each)) <= set(decoded(path, *arguments))


# Preferences -------------------------------------------------------------------------------------------------------

def test_link_types_of_others():
    lines = said("-o", "yapp.user_dlt:0-162", "-r", tshark.CAPTURES / "can/document_command.pcap")
    assert lines == ["yapp: preferences: yapp.user_dlt: link type 0 is no DLT_USER; those are 147 to 162"]


# candump text ------------------------------------------------------------------------------------------------------

MEGABYTE = 2**20
LINES = {
    "digits": b"0" * MEGABYTE,
    "data": b"(1700000000.000000) can0 00000000#" + b"00" * MEGABYTE,
    "name": b"(1700000000.000000) " + b"can" * MEGABYTE + b" 00000000#00",
    "time": b"(" + b"1" * MEGABYTE + b".000000) can0 00000000#00",
    "decimals": b"(1." + b"0" * MEGABYTE + b") can0 00000000#00",
    "blanks": b"(1700000000.000000) can0 00000000#00" + b" " * MEGABYTE,
    "brackets": b"(" * MEGABYTE,
    "high bytes": b"\xff" * MEGABYTE,
    "carriage returns": b"\r" * MEGABYTE,
}
COMMAND = b"(1700000000.000000) can0 00000000#015A014F80F380\n"


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("name", levels.few(LINES, ["data", "high bytes"]))
@pytest.mark.parametrize("ended", [True, False], ids=["ended", "endless"])
def test_candump_lines_of_a_megabyte(folder, name, ended):
    """Skipped with one message; the frames around it are read."""
    path = folder / "long.log"
    path.write_bytes(COMMAND * 2 + LINES[name] + (b"\n" + COMMAND if ended else b""))
    numbers, lines = decoded_and_said(path)
    assert numbers == ([1, 2, 3] if ended else [1, 2])
    assert len(lines) <= 3 and all(len(line) < 300 for line in lines)
    assert any("line 3" in line and "not understood" in line for line in lines), lines


def test_many_bad_candump_lines(folder):
    """Not a message for each of them."""
    path = folder / "bad.log"
    path.write_bytes(COMMAND * 50 + b"(1700000000.000000) can0 00000000#0\n" * levels.size(10000, 100000) + COMMAND)
    numbers, lines = decoded_and_said(path)
    assert numbers == list(range(1, 52)) and len(lines) <= 20


# Wireshark's own memory ----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", levels.few(
    ["can/document_motor.pcap", "can/two_interfaces.pcapng", "serial/dump_document.yapp", "candump/candump_log_two_buses.log",
     "other/motor.asc"], ["serial/dump_document.yapp"]))
def test_a_collector_that_is_always_at_work(name):
    """Wireshark 4.4 writes to the arguments of a reader's function after it has returned: if one was collected meanwhile, into
    memory of others, and ends."""
    script = pathlib.Path(__file__).with_name("collect.lua")
    shown = tshark.run("-X", f"lua_script:{script}", "-r", tshark.CAPTURES / name, "-T", "fields", "-e", "yapp.id",
                       env={"YAPP_COLLECT": "1"})
    assert shown.stdout.strip() and "pause 1\n" in shown.stderr
