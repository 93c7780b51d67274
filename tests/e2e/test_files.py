# SPDX-License-Identifier: GPL-2.0-or-later
"""docs/files.md: each file of its table opens, or does not, as the table says for this Wireshark."""
import gzip
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

import levels
import tshark

FOLDER = tshark.CAPTURES / "other"
DOCUMENT = tshark.ROOT / "docs/files.md"
PYTHON = os.environ.get("YAPP_PYTHON") or ("/usr/bin/python3" if os.path.exists("/usr/bin/python3") else sys.executable)
# Voltage of Motor Data, speed of Command.
WHOLE = {"motor": ["47.97314\t", "47.97314\t", "\t671.4482"], "motor_fd": ["47.97314\t"],
         "two_interfaces": ["47.97314\t", "47.97314\t"]}


def table():
    """(file, what the table says of this Wireshark)"""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in DOCUMENT.read_text().splitlines()
             if line.startswith("|")]
    versions = [tuple(int(part) for part in cell.split(".")) for cell in lines[0][2:-1]]
    column = 2 + max((at for at, version in enumerate(versions) if version <= tshark.version()), default=0)
    return [(name, line[column]) for line in lines[2:] for name in line[-1].split(", ")]


def messages(path):
    done = tshark.run("-2", "-r", path, "-T", "fields", "-e", "taurus.motor.dc_voltage", "-e", "taurus.command.rpm",
                      check=False)
    return [line for line in done.stdout.splitlines() if line.strip()], done.stderr


# One of each reader's; how files are packed is Wireshark's.
USUAL = ["motor.asc", "motor.blf", "motor.crt", "motor.log", "motor_2_1.trc", "motor_fd.log", "motor_savvycan.csv",
         "two_interfaces.pcapng.gz"]


@levels.by_version
@pytest.mark.parametrize("name, says", levels.few(table(), [row for row in table() if row[0] in USUAL], several=True),
                         ids=lambda value: value)
def test_table(name, says):
    whole = WHOLE[re.match(r"(motor_fd|motor|two_interfaces)", name)[0]]
    shown, errors = messages(FOLDER / name)
    if says == "no":
        assert shown == [] and "isn't a capture file in a format" in errors
    else:
        assert shown == {"yes": whole, "not Commands": whole[:-1]}[says], errors


@levels.without_tshark("of the page alone")
def test_table_has_every_file():
    assert {name for name, _ in table()} == {path.name for path in FOLDER.iterdir()} - {"make.py"}


def test_names_of_channels():
    """ASC tells the channel; the bus of BLF is not known."""
    blf = tshark.fields(FOLDER / "motor.blf", ["taurus.motor.dc_voltage", "yapp.bus"], "-2")
    assert [row[1] for row in blf if row[0]] == ["", ""]
    rows = tshark.fields(FOLDER / "motor.asc", ["taurus.motor.dc_voltage", "yapp.bus", "yapp.source"], "-o",
                         "yapp.sources:CAN-2/0x210=motor:right")
    assert [row[1] for row in rows if row[0]] == ["CAN-1", "CAN-2"]
    left, right = [row[2] for row in rows if row[0]]
    assert left in ("0x210", "CAN-1 0x210") and right == "right"


@levels.without_tshark("reads the sources")
def test_readers_hold_what_wireshark_hands_them():
    """A reader that does not name an argument does not hold it: collected while the reader reads, it is freed, and
    Wireshark writes into it afterwards.  4.4.18 ended with "malloc(): mismatching next->prev_size"."""
    wanted = {"read_open": 2, "read": 3, "seek_read": 4}
    found = [(path.name, name, arguments.count(",") + 1) for path in (tshark.PLUGIN / "yapp").rglob("*.lua")
             for name, arguments in re.findall(r"(?m)function handler\.(\w+)\((.*?)\)(?: --.*)?$", path.read_text())]
    assert len(found) >= 4
    assert [(file, name) for file, name, count in found if count != wanted[name]] == []


@pytest.mark.parametrize("name", levels.few(
    ["can/document_motor.pcap", "can/two_interfaces.pcapng", "serial/dump_document.yapp", "candump/candump_log_two_buses.log",
     "other/motor.asc"], ["serial/dump_document.yapp"]))
def test_a_collector_that_is_always_at_work(name):
    """Wireshark 4.4 writes to the arguments of a reader's function after it has returned: if one was collected meanwhile, into
    memory of others, and ends."""
    shown = tshark.run("-X", f"lua_script:{pathlib.Path(__file__).with_name('collect.lua')}", "-r", tshark.CAPTURES / name, "-T", "fields", "-e", "yapp.id",
                       env={"YAPP_COLLECT": "1"})
    pause = 1 if tshark.version() < (4, 4) else 0  # Lua 5.4 rounds it down
    assert shown.stdout.strip() and f"pause {pause}\n" in shown.stderr


# A compressed file that is damaged ---------------------------------------------------------------------------------------

def cut_off(packed):
    return packed[:len(packed) * 3 // 4]


def overwritten(packed):
    at = len(packed) * 3 // 4
    return packed[:at] + bytes(10) + packed[at + 10:]


def wrong_sum(packed):
    return packed[:-6] + bytes([packed[-6] ^ 1]) + packed[-5:]


@pytest.mark.parametrize("damage, repeats", [(cut_off, 1), (overwritten, 1), (wrong_sum, 1), (cut_off, 8)])
def test_buses_of_a_damaged_file(folder, damage, repeats):
    """Wireshark lets nobody read its last bytes but its own reader.  Large: the first bytes can be read."""
    flight = (tshark.ROOT / "docs/flight.pcapng").read_bytes()
    packets = flight.index(b"\6\0\0\0\x30")
    path = folder / "flight.pcapng.gz"
    path.write_bytes(damage(gzip.compress(flight[:packets] + flight[packets:] * repeats)))
    done = tshark.run("-q", "-r", path, "-z", "yapp,summary,json", check=False)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert {(row["bus"], row["id"]) for row in rows} == {(bus, number) for bus in ("can0", "can1") for number in (0, 0x200, 0x210)}
    assert "apart" not in done.stderr and "two controllers" not in done.stderr
    assert re.search("cut short|damaged|corrupt", done.stderr) and done.returncode != 0


def test_a_damaged_log(folder):
    """What can be read is shown, and that there was more."""
    path = folder / "run.log.gz"
    lines = (tshark.CAPTURES / "cases/c06_two_buses_truth.log").read_text().splitlines()
    text = "".join(f"({1700000000 + i / 1000:.6f}) {lines[i % len(lines)].split(' ', 1)[1]}\n" for i in range(20000))
    path.write_bytes(cut_off(gzip.compress(text.encode(), 1)))
    done = tshark.run("-q", "-r", path, "-z", "yapp,check,motor.count=100", check=False, lua_errors=True)
    assert re.search("the file cannot be read behind byte|cut short", done.stderr) and done.returncode not in (0, 21)
    if tshark.version() < (4, 4):  # later versions do not open it
        assert re.search(r"(?m)^ok +motor.count=100 +can1", done.stdout)
