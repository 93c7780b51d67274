# SPDX-License-Identifier: GPL-2.0-or-later
"""-z yapp,watch: what a bench shows while the motor turns.  player.py is the bench; what it plays is the truth."""
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time

import pytest

import model
import player
import published
import tshark

CLEAR, RED, NORMAL = "\x1b[H\x1b[J", "\x1b[31m", "\x1b[m"
NAMES = ["-o", "yapp.motor_ids:0x210-0x211", "-o", "yapp.sources:0x210=motor:left, 0x211=motor:right"]
SECONDS = 6


def command(options="", more=()):
    return ["tshark", *tshark.load(), *NAMES, "-Q", *more, "-i", "-", "-z", f"yapp,watch{options}"]


def environment(**more):
    return {**os.environ, "HOME": str(tshark.home()), "LC_ALL": "C.UTF-8", "TZ": "UTC", **more}


def bench(seconds=SECONDS):
    return subprocess.Popen([sys.executable, player.__file__, str(seconds)], stdout=subprocess.PIPE)


def in_terminal(options="", size=(24, 120), env=None):
    """What tshark writes to a terminal."""
    source = bench()
    pid, terminal = pty.fork()
    if pid == 0:  # the terminal is the child's own: stty asks it
        os.dup2(source.stdout.fileno(), 0)
        os.execvpe("tshark", command(options), environment(**(env or {})))
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
    begin, written = time.time(), b""
    while time.time() - begin < 60:
        if not select.select([terminal], [], [], 0.2)[0]:
            continue
        try:
            written += os.read(terminal, 65536)
        except OSError:  # the end
            break
    os.waitpid(pid, 0)
    source.wait()
    return written.decode("utf-8").replace("\r\n", "\n")


def screens(written):
    """The screens: lists of lines, without what tshark writes before the first one."""
    parts = written.split(CLEAR)[1:]
    assert len(parts) >= 3
    # tshark writes "tshark: " where a pipe ends.
    return [part.split("\n\n")[0].replace("tshark: \n", "").rstrip("\n").split("\n") for part in parts]


def row(screen, name):
    found = [line for line in screen if re.match(f"(\x1b\\[31m)?{name} ", line)]
    return found[0] if found else None


def test_in_a_terminal():
    """A row that turns red, and a fault that stays with its time; at the end what `faults` prints."""
    written = in_terminal()
    found = [screen for screen in screens(written) if row(screen, "left")][1:]  # the first may come before "right" does
    assert not re.sub(r"\x1b\[(H|J|31m|m)", "", written).count("\x1b")
    for screen in found:
        assert [row(screen, name) is not None for name in ("left", "right")] == [True, True]
        assert "999.8/999.8 RPM  48.00 V  2.00 A" in row(screen, "left")
    last = found[-1]
    assert re.search(r"Motor Data +60 ", row(last, "left")) and re.search(r"Motor Data +30 ", row(last, "right"))
    assert re.search(r"\(motor_overcurrent at \d\d:\d\d:\d\d\)", row(last, "left"))
    assert row(last, "right").startswith(RED) and "SILENT" in row(last, "right") and row(last, "right").endswith(NORMAL)
    assert not row(last, "left").startswith(RED)
    behind = written.rpartition("\n\nYAPP faults: ")[2]
    assert behind.startswith("1\n") and behind.count("motor_overcurrent") == 2


@pytest.mark.parametrize("size, height", [((7, 80), 7), ((0, 0), 24)], ids=["small", "serial console without a size"])
def test_a_small_terminal_without_colour(size, height):
    written = in_terminal(",bitrate=500000", size=size, env={"NO_COLOR": "1"})
    assert RED not in written
    for screen in screens(written):
        assert len(screen) < height and max(map(len, screen)) <= 80, screen
    assert re.search(r"SILENT +1999\.7/19", row(screens(written)[-1], "right"))
    assert any(line.startswith("bus ") for line in screens(written)[-1])


def test_lines_of_json(tmp_path):
    """In a pipe: a line a second, with the keys of summary, check and buses; then the lines of faults."""
    (tmp_path / "rules.txt").write_text("motor.rpm_measured=..1500\nfault=0\nmotor.count=1\n")
    source = bench()
    done = subprocess.run(command(f",rules={tmp_path}/rules.txt,bitrate=500000"), stdin=source.stdout, capture_output=True, text=True,
                          env=environment(), timeout=60, check=False)
    source.wait()
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    states = [line for line in lines if "sources" in line]
    assert SECONDS - 3 <= len(states) <= SECONDS + 2
    last = {one["source"]: one for one in states[-1]["sources"]}
    assert {name: one["count"] for name, one in last.items()} == {"left": 60, "right": 30}
    keys = {kind: [key.removeprefix(f"{kind}.") for key in published.of("key") if key.startswith(f"{kind}.")] for kind in model.STATISTICS}
    assert list(last["left"])[:len(keys["summary"])] == keys["summary"]
    assert {tuple(rule) for rule in states[-1]["rules"]} == {tuple(keys["check"])}
    assert {tuple(bus) for bus in states[-1]["buses"]} == {tuple(keys["buses"])}
    assert [line["event"] for line in lines if "flag" in line] == ["raised", "cleared"]
    assert done.returncode == 0 and "damaged or lost messages may hide faults: " in done.stderr  # not in the output


@pytest.mark.parametrize("option, at", [("stop=fault", 4), ("rules={}/rules.txt,stop=rule", 0)])
def test_it_ends_the_run(tmp_path, option, at):
    """With 20, within a second of the fault or the rule; the file of -w is whole, and has the frame that ended it."""
    tmp_path.chmod(0o777)
    (tmp_path / "rules.txt").write_text("motor.rpm_measured=..1500\nmotor.count=50\n")
    capture = tmp_path / "run.pcapng"
    source = bench(12)
    done = subprocess.run(command("," + option.format(tmp_path), ["-w", str(capture)]), stdin=source.stdout, capture_output=True, text=True,
                          env=environment(), timeout=60, check=False)
    source.kill()
    assert done.returncode == 20 and "failed" not in done.stderr, done.stderr
    times = tshark.fields(capture, ["frame.time_relative"])
    assert at <= float(times[-1][0]) < at + 6  # what waits in the pipe while tshark starts counts, too
    read = tshark.run("-q", "-r", capture, *NAMES, "-z", "yapp,check,json,fault=0", "-z", "yapp,summary,json", check=False)
    assert "appears to have been cut short" not in read.stderr
    lines = [json.loads(line) for line in read.stdout.splitlines()]
    if "fault" in option:
        assert [line["ok"] for line in lines if line.get("source") == "left" and "ok" in line] == [False]


def test_ctrl_c():
    source = bench(30)
    running = subprocess.Popen(command(), stdin=source.stdout, stdout=subprocess.PIPE, text=True, env=environment())
    assert "sources" in running.stdout.readline()
    running.send_signal(signal.SIGINT)
    out, _ = running.communicate(timeout=20)
    source.kill()
    lines = [json.loads(line) for line in out.splitlines()]
    assert lines and "sources" in lines[-1] and running.returncode == 0


def test_a_bench_in_five_minutes():
    """The command of docs/live.md, as it stands there, but for a shorter time: a row falls silent."""
    page = (tshark.ROOT / "docs/live.md").read_text("utf-8")
    line = re.search(r"^    (python3 tests/e2e/player\.py 30 .*yapp,watch)$", page, re.M)[1]
    line = line.replace("player.py 30", "player.py 6").replace("tshark ", f"tshark {' '.join(tshark.load())} ")
    done = subprocess.run(line, shell=True, cwd=tshark.ROOT, env=environment(), capture_output=True, text=True, timeout=60, check=True)
    states = [json.loads(text) for text in done.stdout.splitlines() if '"sources"' in text]
    ages = {one["id"]: one["age"] for one in states[-1]["sources"]}
    assert ages[player.RIGHT] > 2 > ages[player.LEFT]
