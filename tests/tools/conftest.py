# SPDX-License-Identifier: GPL-2.0-or-later
"""Fixtures: captures for the stand-in of tshark, and the command that runs with it."""

import json
import signal

import pytest
from running import FAKE, run_tables


@pytest.fixture(autouse=True)
def no_test_hangs():
    """A test fails that takes ten minutes, whatever it waits for."""

    def end(_number, _frame):
        raise TimeoutError("this test takes ten minutes")

    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, end)
        signal.alarm(600)
    yield
    if hasattr(signal, "SIGALRM"):
        signal.alarm(0)


@pytest.fixture
def make_capture(tmp_path):
    """Writes a capture for the stand-in: make_capture("flight.pcapng", motor=[row, ...], does=["crash"])."""

    def make(name, **content):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))
        return path

    return make


@pytest.fixture
def yapp_tables(tmp_path):
    """Runs the command with the stand-in for tshark; returns the finished process."""

    return lambda *arguments, **options: run_tables(tmp_path, *arguments, "--tshark", FAKE, **options)
