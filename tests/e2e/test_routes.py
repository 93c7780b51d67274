# SPDX-License-Identifier: GPL-2.0-or-later
"""docs/files.md, "Convert other files": the page's own commands, run on what the other programs write; the log that comes out
shows what was sent."""
import random
import re
import shutil
import struct
import subprocess

import pytest

import can_generator
import flights
import levels
import tshark
from test_files import DOCUMENT, PYTHON
from test_recorders import CASES, events, motor_count

SECTIONS = dict(re.findall(r"^### (.+?)\n(.*?)(?=^##)", DOCUMENT.read_text().split("## Convert other files")[1] + "\n##",
                           re.MULTILINE | re.DOTALL))
has_python_can = pytest.mark.skipif(subprocess.run([PYTHON, "-c", "import can.logconvert"], capture_output=True,
                                                   check=False).returncode != 0, reason="no python-can")


def commands(title):
    blocks = re.findall(r"(?:^    .*\n|^\n(?=    ))+", SECTIONS[title], re.MULTILINE)
    return [re.sub(r"^    ", "", block, flags=re.MULTILINE).strip("\n") + "\n" for block in blocks if block.strip()]


def run(folder, *lines):
    for line in lines:
        line = re.sub(r"(?m)^python3 ", f"{PYTHON} ", line)
        done = subprocess.run(["bash", "-euo", "pipefail", "-c", line], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (line, done.stderr)


def python_can():
    done = subprocess.run([PYTHON, "-c", "import can; print(can.__version__)"], capture_output=True, text=True, check=True)
    return tuple(int(part) for part in done.stdout.split(".")[:2])


def changes(path):
    return [(event["bus"], event["event"]) for event in events(path) if event["kind"] == "fault"]


def logconvert(source, target):
    subprocess.run([PYTHON, "-m", "can.logconvert", source, target], check=True, capture_output=True)


def test_busmaster(folder):
    """Two channels: Wireshark alone mixes them; the route gives each its bus."""
    shutil.copy(CASES / "c10_busmaster_two_channels.log", folder / "run.log")
    assert {"shared", "stale"} & {event["kind"] for event in events(folder / "run.log")}
    run(folder, *commands("BUSMASTER's log"))
    found = events(folder / "frames.log")
    assert motor_count(folder / "frames.log") == 24
    assert {event["bus"] for event in found} <= {"can1", "can2"} and {event["kind"] for event in found} <= {"fault"}
    assert [event["event"] for event in found] == ["raised", "cleared"]
    times = [float(row[0]) for row in tshark.fields(folder / "frames.log", ["frame.time_epoch"])]
    assert times[0] == 22 * 3600 + 13 * 60 + 20 and times == sorted(times)


def test_busmaster_over_midnight(folder):
    lines = ["***BUSMASTER Ver 3.2.2***", "***HEX***", "23:59:59:9999 Tx 1 0x123 s 2 0A 0B ", "00:00:00:0001 Rx 1 0x0 x 1 0C ",
             "00:00:01:0000 Rx 2 0x84 xr 4 ", "***[STOP LOGGING SESSION]***"]
    (folder / "run.log").write_text("\r\n".join(lines), newline="")
    run(folder, *commands("BUSMASTER's log"))
    assert (folder / "frames.log").read_text().splitlines() == [
        "(86399.999900) can1 123#0A0B T", "(86400.000100) can1 00000000#0C R", "(86401.000000) can2 00000084# R"]


def test_busmaster_without_0x(folder):
    """As its converter of BLF writes ids."""
    text = (CASES / "c10_busmaster_two_channels.log").read_text()
    assert text.count(" 0x") > 100
    (folder / "run.log").write_text(text.replace(" 0x", " "))
    run(folder, *commands("BUSMASTER's log"))
    assert motor_count(folder / "frames.log") == 24


@pytest.mark.parametrize("title, name", [("Text that python-can prints", "c11_pythoncan_printer.txt")])
def test_text_of_other_tools(folder, title, name):
    shutil.copy(CASES / name, folder / "run.txt")
    run(folder, *commands(title))
    frames = tshark.fields(folder / "run.log", ["can.id", "data.data"])
    assert len(frames) == 26 and motor_count(folder / "run.log") == 4
    kinds = {event["kind"] for event in events(folder / "run.log")}
    assert not kinds & {"dropped", "incomplete", "crc", "unknown", "clock"}


@has_python_can
@pytest.mark.parametrize("name, values", [("motor.log", 2), ("motor_fd.log", 1)])
def test_printer_of_python_can_itself(folder, name, values):
    logconvert(tshark.CAPTURES / "other" / name, folder / "run.txt")
    run(folder, *commands("Text that python-can prints"))
    assert motor_count(folder / "run.log") == motor_count(tshark.CAPTURES / "other" / name) == values


@has_python_can
@pytest.mark.parametrize("seed", range(1, levels.size(2, 10)))
def test_printer_of_a_flight(folder, seed):
    flight = flights.make(seed)
    log = flight.write(folder / "flight.log", "candump")
    logconvert(log, folder / "run.txt")
    run(folder, *commands("Text that python-can prints"))
    wanted, found = (tshark.fields(path, ["taurus.motor.dc_voltage", "taurus.motor.rpm_measured", "yapp.bus"],
                                   *flight.arguments("candump")) for path in (log, folder / "run.log"))
    assert found == wanted and any(row[0] for row in wanted)


@has_python_can
def test_trc(folder):
    """Two buses, and CAN FD, whose lengths are codes."""
    shutil.copy(CASES / "c08_two_buses_2_1.trc", folder / "run.trc")
    run(folder, commands("TRC, MF4 and python-can's CSV")[0].splitlines()[0])
    assert motor_count(folder / "run.log") == 24 and changes(folder / "run.log")[0][0] in ("can1", "can2")
    lengths = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]
    lines = [";$FILEVERSION=2.1", ";$STARTTIME=45244.9259259259", ";$COLUMNS=N,O,T,B,I,d,R,L,D", ";"]
    for number, line in enumerate((CASES / "c06_fd_single_hash.log").read_text().splitlines(), 1):
        time, _, frame = line.split()
        ident, data = frame.split("#")
        data = bytes.fromhex(data)
        lines.append(f"{number:7d} {float(time[1:-1]) % 10**6 * 1000:13.3f} FB 1  {ident} Rx -  {lengths.index(len(data))}    "
                     f"{data.hex(' ').upper()} ")
    (folder / "run.trc").write_text("\r\n".join(lines) + "\r\n", newline="")
    if tshark.version() >= (4, 6):  # as the page says
        assert motor_count(folder / "run.trc") == 0
    if python_can() >= (4, 2):  # as the page says
        run(folder, commands("TRC, MF4 and python-can's CSV")[0].splitlines()[0])
        assert motor_count(folder / "run.log") == 12


@has_python_can
def test_csv_that_lost_its_buses(folder):
    """Messages of two controllers with the same ID interleave: each is put together, and "shared" says it."""
    shutil.copy(CASES / "c06_pythoncan.csv", folder / "run.csv")
    run(folder, commands("TRC, MF4 and python-can's CSV")[0].splitlines()[2])
    columns = ["taurus.motor.timestamp", "taurus.motor.fault_flags"]
    wanted = sorted(row for row in tshark.fields(CASES / "c06_two_buses_truth.log", columns) if row[0])
    assert sorted(row for row in tshark.fields(folder / "run.log", columns) if row[0]) == wanted and len(wanted) == 24
    kinds = {event["kind"] for event in events(folder / "run.log")}
    assert "shared" in kinds and not kinds & {"incomplete", "crc", "unfinished"}


@pytest.mark.parametrize("passes", [(), ("-2",)], ids=len)
@pytest.mark.parametrize("buses", [2, 3])
def test_merged_logs(folder, buses, passes):
    """The logs of several buses as one, all lines of can0."""
    flight = flights.make(3 if buses == 2 else 4, is_clean=True)
    frames = [(frame.at + 1000 * bus, frame) for frame in flight.frames for bus in range(buses) if frame.bus == 0]
    lines = [f"({at // 10**9}.{at % 10**9 // 1000:06d}) can0 {frame.can_id:08X}#{frame.data.hex().upper()}"
             for at, frame in sorted(frames, key=lambda one: one[0])]
    (folder / "run.log").write_text("\n".join(lines) + "\n")
    found = tshark.fields(folder / "run.log", ["yapp.crc.status", "yapp.fragment.orphan", "yapp.fragment.incomplete"], *passes)
    sent = [message for sender in flight.senders if sender.bus == 0 for message in sender.messages if len(message.frames) > 1]
    good = [row for row in found if row[0] == "1"]
    assert sent and len(good) == buses * len(sent)
    if passes:  # in one pass they are withdrawn too late
        assert not any(row[1] or row[2] for row in found)


def test_any_csv(folder):
    lines = ["time,id,data"]
    for line in (CASES / "c06_fd_single_hash.log").read_text().splitlines():
        time, _, frame = line.split()
        ident, data = frame.split("#")
        lines.append(f"{time[1:-1]}, 0x{int(ident, 16):x}, {bytes.fromhex(data).hex(' ')}")
    (folder / "run.csv").write_text("\r\n".join(lines), newline="")
    run(folder, *commands("Any other CSV"))
    assert motor_count(folder / "run.log") == 12


def test_each_section_has_a_test():
    """A route that is added to the page is run."""
    titles = {title for title in SECTIONS if commands(title)}
    source = open(__file__, encoding="utf-8").read()
    assert titles and all(f'"{title}"' in source for title in titles), titles
