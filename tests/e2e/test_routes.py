# SPDX-License-Identifier: GPL-2.0-or-later
"""docs/files.md, "Convert other files": the page's own commands, run on what the other programs write; the log that comes out
shows what was sent."""
import re
import shutil
import struct
import subprocess

import pytest

import levels
import stream_captures
import test_readme
import tshark
from test_files import DOCUMENT, PYTHON
from test_recorders import CASES, events

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


def motor_count(path):
    found = tshark.fields(path, ["taurus.motor.dc_voltage"])
    return sum(1 for row in found if row[0])


def changes(path):
    return [(event["bus"], event["event"]) for event in events(path) if event["kind"] == "fault"]


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
    """Messages of two controllers with the same ID interleave: each is put together, and that is said, although the clocks of
    both are equal to the nanosecond."""
    shutil.copy(CASES / "c06_pythoncan.csv", folder / "run.csv")
    run(folder, commands("TRC, MF4 and python-can's CSV")[0].splitlines()[2])
    columns = ["taurus.motor.timestamp", "taurus.motor.fault_flags"]
    wanted = sorted(row for row in tshark.fields(CASES / "c06_two_buses_truth.log", columns) if row[0])
    assert sorted(row for row in tshark.fields(folder / "run.log", columns) if row[0]) == wanted and len(wanted) == 24
    kinds = {event["kind"] for event in events(folder / "run.log")}
    assert "shared" in kinds and not kinds & {"incomplete", "crc", "unfinished"}


@pytest.mark.parametrize("trigger", [0, 1_700_000_001])
def test_any_csv(folder, trigger):
    """Also of an oscilloscope, whose times before the trigger are negative."""
    lines = ["time,id,data"]
    for line in (CASES / "c06_fd_single_hash.log").read_text().splitlines():
        time, _, frame = line.split()
        ident, data = frame.split("#")
        lines.append(f"{float(time[1:-1]) - trigger:.6f}, 0x{int(ident, 16):x}, {bytes.fromhex(data).hex(' ')}")
    (folder / "run.csv").write_text("\r\n".join(lines), newline="")
    run(folder, *commands("Any other CSV"))
    assert motor_count(folder / "run.log") == 12


LOG = (tshark.CAPTURES / "candump/candump_log_plain.log").read_text().splitlines()


@pytest.mark.parametrize("prefix", ["", "Nov 14 22:13:20 pi candump[512]: ", "2023-11-14T22:13:20.013000000Z ", "candump-1  | "])
def test_lines_with_a_prefix(folder, prefix):
    (folder / "run.txt").write_text("".join(f"{prefix}{line}\n" for line in LOG))
    run(folder, *commands("Lines with a prefix"))
    assert (folder / "run.log").read_text().splitlines() == LOG


def log_frames():
    for line in LOG:
        stamp, _, frame = line.split()
        ident, data = frame.split("#")
        yield float(stamp[1:-1]), ident, bytes.fromhex(data)


@pytest.mark.parametrize("end, stamps", [("\r", False), ("\r\n", True), ("\n", False)])
def test_slcan(folder, end, stamps):
    """With stamps of the adapter, too, and its answers."""
    lines = [f"T{ident}{len(data)}{data.hex().upper()}{'%04X' % number * stamps}" for number, (_, ident, data) in enumerate(log_frames())]
    (folder / "run.txt").write_text(end.join(["O", "V1013", *lines, "z", ""]), newline="")
    run(folder, *commands("SLCAN"))
    assert motor_count(folder / "run.log") == motor_count(tshark.CAPTURES / "candump/candump_log_plain.log") > 0


def test_can_in_udp(folder):
    """One or several frames in a datagram."""
    packets, frames = [], list(log_frames())
    while frames:
        some = frames[:len(packets) % 3 + 1]
        data = b"".join(struct.pack(">HHQIIBBHI8s", 36, 0x80, 0, 0, 0, 0, len(data), 2, 1 << 31 | int(ident, 16), data)
                        for _, ident, data in some)
        packet = stream_captures.Packet(data, stream_captures.Origin(stream_captures.ETHERNET, 0, 0))
        packet.time = round(some[0][0] * 1e6)
        packets.append(packet)
        frames = frames[len(some):]
    stream_captures.Capture("", packets, stream_captures.udp, []).write(folder / "run.pcap")
    run(folder, *commands("CAN in UDP"))
    found = [line.upper().split()[1:] for line in (folder / "run.log").read_text().splitlines()]
    assert found == [line.upper().split()[1:] for line in LOG]


@levels.by_version
def test_blf_keeps_its_channels(folder):
    (folder / "test_captures").symlink_to(tshark.CAPTURES)
    command = re.search("    (tshark -r .*/motor.blf -w .*)", DOCUMENT.read_text())[1]
    assert test_readme.shell(folder, command).returncode == 0
    rows = tshark.fields(folder / "motor.pcapng", ["yapp.bus"], "-Y", "taurus.motor")
    assert rows == [["CAN-1"], ["CAN-2"]]


def test_each_section_has_a_test():
    """A route that is added to the page is run."""
    titles = {title for title in SECTIONS if commands(title)}
    source = open(__file__, encoding="utf-8").read()
    assert titles and all(f'"{title}"' in source for title in titles), titles
