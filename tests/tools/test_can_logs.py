# SPDX-License-Identifier: GPL-2.0-or-later
"""docs/files.md: MF4 becomes a candump log, with python-can and asammdf; the log has every frame and both buses."""

import re
import subprocess
import sys

import pytest
from running import TOP

LOG = TOP / "test_captures/cases/c06_two_buses_truth.log"
PAGE = (TOP / "docs/files.md").read_text()
COMMAND = re.search(r"^    python3 (-m can\.logconvert) (run\.mf4) (run\.log)$", PAGE, re.M)


def convert(*arguments, cwd):
    done = subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def frames(path):
    """[(seconds since the first frame, bus, id and data)]"""
    found = [line.split()[:3] for line in path.read_text().splitlines()]
    times = [float(stamp.strip("()")) for stamp, _, _ in found]
    return [
        (pytest.approx(time - times[0], abs=1e-5), bus, frame)
        for time, (_, bus, frame) in zip(times, found, strict=True)
    ]


def test_mf4(tmp_path):
    module = COMMAND[1].split()
    # python-can numbers the channels of MF4 from 1.
    two = re.sub(r"can(\d)", lambda found: f"can{int(found[1]) + 1}", LOG.read_text())
    (tmp_path / "two.log").write_text(two)
    convert(*module, "two.log", COMMAND[2], cwd=tmp_path)
    convert(*module, COMMAND[2], COMMAND[3], cwd=tmp_path)
    found = frames(tmp_path / "run.log")
    assert len(found) == 156
    assert {bus for _, bus, _ in found} == {"can1", "can2"}
    assert [one[1:] for one in found] == [one[1:] for one in frames(tmp_path / "two.log")]
    assert [one[0].expected for one in found] == [one[0] for one in frames(tmp_path / "two.log")]
