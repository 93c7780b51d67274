# SPDX-License-Identifier: GPL-2.0-or-later
"""Sizes and lengths at their ends.  Time and memory stay bounded, and what is good is still decoded."""
import pathlib
import resource
import struct

import pytest

import capture_file
import levels
import tshark

MEMORY = 2 * 2**30  # address space; a plain run takes a quarter
SECONDS = 60  # of CPU; a plain run takes half of one


def limits():
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def decoded(path, *arguments):
    """The numbers of the frames with a Taurus message, the same in one pass and in two, with no error in Lua in either."""
    found = []
    for two in ((), ("-2",)):
        done = tshark.run(*two, *arguments, "-r", path, "-T", "fields", "-e", "frame.number", "-e", "_ws.lua.error",
                          "-e", "taurus.command.key", "-e", "taurus.motor.fault_flags", limits=limits)
        assert "Dissector bug" not in done.stderr
        rows = [line.split("\t") for line in done.stdout.splitlines()]
        assert [row for row in rows if row[1]] == []
        found.append([int(row[0]) for row in rows if row[2] or row[3]])
    assert found[0] == found[1]
    return found[0]


# Sizes and lengths -------------------------------------------------------------------------------------------------


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
    path.write_bytes(capture_file.pcap(capture_file.SOCKETCAN, [(at * 10**6, one) for at, one in enumerate(records)]))
    each = len(HEADS) + 1
    assert set(range(each, len(records) + 1, each)) <= set(decoded(path, *arguments))


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
