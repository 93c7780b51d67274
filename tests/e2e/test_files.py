# SPDX-License-Identifier: GPL-2.0-or-later
"""docs/files.md: each file of its table opens, or does not, as the table says for this Wireshark."""
import os
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


def test_table_has_every_file():
    assert {name for name, _ in table()} == {path.name for path in FOLDER.iterdir()} - {"make.py"}


def test_buses_are_told_apart():
    for name, says in table():
        if says != "no" and name in ("motor.blf", "motor_2_1.trc"):
            rows = tshark.fields(FOLDER / name, ["frame.interface_id", "taurus.motor.dc_voltage"], "-2")
            assert [row[0] for row in rows if row[1]] == ["0", "1"]


def test_channels_of_asc():
    rows = tshark.fields(FOLDER / "motor.asc", ["sll.ifindex", "taurus.motor.dc_voltage", "frame.time_epoch"], "-2")
    assert [(row[0], row[2]) for row in rows if row[1]] == [("1", "1700000000.004000000"), ("2", "1700000000.009000000")]
    tshark.assert_no_lua_errors(FOLDER / "motor.asc")


@pytest.mark.parametrize("name", ["motor.asc", "motor.blf"])
@pytest.mark.parametrize("passes", [[], ["-2"]], ids=len)
def test_names_of_channels(name, passes):
    """CANoe writes both: what one is called in a filter, a table and a preference is the same in the other."""
    rows = tshark.fields(FOLDER / name, ["taurus.motor.dc_voltage", "yapp.bus", "yapp.source"], "-o",
                         "yapp.sources:CAN-2/0x210=motor:right", *passes)
    assert [row[1:] for row in rows if row[0]] == [["CAN-1", ""], ["CAN-2", "right"]]


def test_two_channels_of_asc_at_once(folder):
    """Their frames in turns: on one bus they would spoil each other."""
    head, frames = re.match(r"(.*?measurement\n)(.*)", (FOLDER / "motor.asc").read_text(), re.DOTALL).groups()
    lines = frames.splitlines(keepends=True)
    path = folder / "mixed.asc"
    path.write_text(head + "".join(line for pair in zip(lines[:5], lines[5:10]) for line in pair))
    for passes in ([], ["-2"]):
        rows = tshark.fields(path, ["frame.number", "yapp.crc.status"], *passes)
        assert [row[0] for row in rows if row[1] == "1"] == ["9", "10"]


def test_conversions(folder):
    """The commands of the document, where python-can is there."""
    commands = re.findall(r"^    python3 -m (can\.logconvert) (\S+) (\S+)", DOCUMENT.read_text(), re.MULTILINE)
    assert len(commands) == 2
    if subprocess.run([PYTHON, "-c", "import can.logconvert"], capture_output=True, check=False).returncode:
        pytest.skip("no python-can")
    for module, source, target in commands:
        shutil.copy(FOLDER / source, folder)
        subprocess.run([PYTHON, "-m", module, source, target], cwd=folder, check=True, capture_output=True)
        assert messages(folder / target)[0] == WHOLE["motor"], source


def test_readers_hold_what_wireshark_hands_them():
    """A reader that does not name an argument does not hold it: collected while the reader reads, it is freed, and
    Wireshark writes into it afterwards.  4.4.18 ended with "malloc(): mismatching next->prev_size"."""
    wanted = {"read_open": 2, "read": 3, "seek_read": 4}
    found = [(path.name, name, arguments.count(",") + 1) for path in (tshark.PLUGIN / "yapp").rglob("*.lua")
             for name, arguments in re.findall(r"(?m)function handler\.(\w+)\((.*?)\)(?: --.*)?$", path.read_text())]
    assert len(found) >= 4
    assert [(file, name) for file, name, count in found if count != wanted[name]] == []


@pytest.mark.parametrize("passes", [(), ("-2",), ("-V",)], ids=" ".join)
def test_every_bus_of_a_log(folder, passes):
    """Of the third and fourth the first frame begins a message."""
    buses = ["can1", "can2", "can0", "vcan7"]
    lines = [line.split(" ", 2)[2] for line in (tshark.CAPTURES / "candump_log_plain.log").read_text().splitlines()]
    text = "".join(f"(1700000000.{at:06d}) {bus} {line}\n" for at, (bus, line) in
                   enumerate((bus, line) for bus in buses for line in lines))
    (folder / "four.log").write_text(text)
    rows = tshark.fields(folder / "four.log", ["yapp.bus", "yapp.source"], *passes, "-o",
                         "yapp.sources:" + ",".join(f"{bus}/0x210=motor:esc_{bus}" for bus in buses))
    assert rows == [[bus, f"esc_{bus}"] for bus in buses for _ in lines]
