# SPDX-License-Identifier: GPL-2.0-or-later
"""docs/files.md: each file of its table opens, or does not, as the table says for this Wireshark."""
import gzip
import json
import os
import re
import resource
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


@pytest.mark.parametrize("passes", [[], ["-2"]], ids=len)
def test_names_of_channels(passes):
    """ASC tells the channel; the bus of BLF is not known."""
    blf = tshark.fields(FOLDER / "motor.blf", ["taurus.motor.dc_voltage", "yapp.bus"], *passes)
    assert [row[1] for row in blf if row[0]] == ["", ""]
    rows = tshark.fields(FOLDER / "motor.asc", ["taurus.motor.dc_voltage", "yapp.bus", "yapp.source"], "-o",
                         "yapp.sources:CAN-2/0x210=motor:right", *passes)
    assert [row[1] for row in rows if row[0]] == ["CAN-1", "CAN-2"]
    left, right = [row[2] for row in rows if row[0]]
    assert left in ("0x210", "CAN-1 0x210") and right == "right"


def cpu_seconds(*arguments, **options):
    """What a run of tshark takes, and the run."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = tshark.run(*arguments, **options)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime, done


@levels.by_version
@pytest.mark.parametrize("name, said", [
    ("h2_asc_blanks.asc", "ASC reader: line 9: not understood"), ("h3_asc_triggerblock.asc", "ASC reader: line 9: not understood"),
    ("h4_candump_blanks.log", "candump reader: line 151: not understood")])
def test_long_lines(folder, name, said):
    """A long line is named, and costs no more than to read it; the frames in front of it are shown."""
    path = tshark.CAPTURES / "cases" / name
    lines = path.read_bytes().splitlines(keepends=True)
    twice = folder / name
    twice.write_bytes(b"".join(line[:-1] + line if len(line) > 4000 else line for line in lines))
    plain, _ = cpu_seconds("-r", tshark.CAPTURES / "cases/g0_clean.pcapng", "-c", "1")
    for file in (path, twice):
        took, done = cpu_seconds("-r", file, "-T", "fields", "-e", "taurus.motor.dc_voltage")
        assert took < plain + 1
        assert said in done.stderr
        assert any(line.strip() for line in done.stdout.splitlines())


@levels.by_version
def test_dates_that_are_not_understood(folder):
    """No error in Lua; the line is named; times count from the date of the file, or from 0."""
    path = tshark.CAPTURES / "cases/h7_asc_day_out_of_bound.asc"
    text, bad = path.read_text(), "Tue Nov 99999999999 22:13:20.001 2023"
    good = "Tue Nov 14 22:13:20.001 2023"
    assert text.count(bad) == text.count(good) == 1
    for content, line, start in [(text, 3, 1700000000.001), (text.replace(good, bad), 1, 0),
                                 (text.replace(bad, "Die Okt 30 10:00:00 2023"), 3, 1700000000.001)]:
        (folder / "date.asc").write_text(content)
        done = tshark.run("-r", folder / "date.asc", "-T", "fields", "-e", "frame.time_epoch", "-e", "taurus.motor.dc_voltage")
        assert f"ASC reader: line {line}: no such date: times count from the date before, or from 0" in done.stderr
        times, values = zip(*(row.split("\t") for row in done.stdout.splitlines()))
        assert [float(time) for time in times] == pytest.approx([start + i / 1000 for i in range(5)], abs=1e-6)
        assert values[-1] == "47.97314"


def test_conversions(folder):
    """The command of the document, where python-can is there."""
    commands = re.findall(r"^    python3 -m (can\.logconvert) run\.(\S+) run\.log$", DOCUMENT.read_text(), re.MULTILINE)
    assert [ending for _, ending in commands] == ["trc", "mf4", "csv"]  # MF4: tests/tools
    if subprocess.run([PYTHON, "-c", "import can.logconvert"], capture_output=True, check=False).returncode:
        pytest.skip("no python-can")
    for module, ending in [commands[0], commands[2]]:
        source = {"trc": "motor_2_1.trc", "csv": "motor.csv"}[ending]
        shutil.copy(FOLDER / source, folder / f"run.{ending}")
        subprocess.run([PYTHON, "-m", module, f"run.{ending}", "run.log"], cwd=folder, check=True, capture_output=True)
        assert messages(folder / "run.log")[0] == WHOLE["motor"], source


@levels.without_tshark("reads the sources")
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
    lines = [line.split(" ", 2)[2] for line in (tshark.CAPTURES / "candump/candump_log_plain.log").read_text().splitlines()]
    text = "".join(f"(1700000000.{at:06d}) {bus} {line}\n" for at, (bus, line) in
                   enumerate((bus, line) for bus in buses for line in lines))
    (folder / "four.log").write_text(text)
    rows = tshark.fields(folder / "four.log", ["yapp.bus", "yapp.source"], *passes, "-o",
                         "yapp.sources:" + ",".join(f"{bus}/0x210=motor:esc_{bus}" for bus in buses))
    assert rows == [[bus, f"esc_{bus}"] for bus in buses for _ in lines]


# A compressed file that is damaged ---------------------------------------------------------------------------------------

def cut_off(packed):
    return packed[:len(packed) * 3 // 4]


def overwritten(packed):
    at = len(packed) * 3 // 4
    return packed[:at] + bytes(10) + packed[at + 10:]


def wrong_sum(packed):
    return packed[:-6] + bytes([packed[-6] ^ 1]) + packed[-5:]


@pytest.mark.parametrize("damage, repeats", [(cut_off, 1), (overwritten, 1), (wrong_sum, 1), (cut_off, 30)])
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
    text = "".join(f"({1700000000 + i / 1000:.6f}) {lines[i % len(lines)].split(' ', 1)[1]}\n" for i in range(60000))
    path.write_bytes(cut_off(gzip.compress(text.encode(), 1)))
    done = tshark.run("-q", "-r", path, "-z", "yapp,check,motor.count=100", check=False, lua_errors=True)
    assert re.search("the file cannot be read behind byte|cut short", done.stderr) and done.returncode not in (0, 21)
    if tshark.version() < (4, 4):  # later versions do not open it
        assert re.search(r"(?m)^ok +motor.count=100 +can1", done.stdout)
