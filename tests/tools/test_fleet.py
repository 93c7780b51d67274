# SPDX-License-Identifier: GPL-2.0-or-later
"""Many captures: local threads, a Dask cluster of processes, workers that are killed."""

import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time

import pyarrow.parquet as pq
import pytest
from running import FAKE, killing, motor_row, run_tables, started, wait_for_results

# Ten run before a run is held, see fake_tshark.py; so four remain when the workers are killed.
COUNT = 14


@pytest.fixture
def fleet(make_capture, tmp_path):
    for number in range(COUNT):
        rows = [motor_row(n, rpm_measured=str(number)) for n in range(100 + number)]
        make_capture(f"flights/{number:02}.pcapng", motor=rows, does=["nap"])
    return tmp_path


def convert(folder, *arguments):
    return run_tables(
        folder, "convert", "flights/*.pcapng", "--to", "parquet", "--out", "data", "--tshark", FAKE, *arguments
    )


def assert_complete(folder, is_clean=True):
    motor = folder / "data/message=motor"
    rows = {int(path.stem[:2]): pq.read_metadata(path).num_rows for path in motor.glob("*.parquet")}
    assert rows == {number: 100 + number for number in range(COUNT)}
    # What a killed run left is removed a day later: another run may still be at work.
    assert not (is_clean and list((folder / "data.yapp-tables").glob("*-work-*")))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_killed_run_is_finished_by_the_next(fleet, number):
    command = [sys.executable, "-m", "yapp_tables", "convert", "flights/*.pcapng", "--to", "parquet", "--out", "data"]
    with started([*command, "--tshark", FAKE, "--jobs", "2"], fleet) as run:
        wait_for_results(fleet, 3)
        (fleet / "flights/hold").touch()  # a tshark that is at work does not end by itself
        while len(list((fleet / "flights").glob("*.tries"))) < 12:
            time.sleep(0.05)
        run.send_signal(number)
        run.wait(timeout=5)
        (fleet / "flights/hold").unlink()
    done = convert(fleet)
    assert done.returncode == 0, done.stderr
    assert_complete(fleet, is_clean=number != signal.SIGKILL)


def test_a_flight_with_two_names_is_there_once(make_capture, tmp_path):
    for number in range(8):
        make_capture(f"flights/{number}.pcapng", motor=[motor_row(0)])
    assert "8 captures, 2 rows in data" in convert(tmp_path, "--jobs", "8").stderr
    assert len(list((tmp_path / "data/message=motor").glob("*"))) == 1


def test_a_scheduler_that_dies_is_a_sentence_and_what_was_done_is_kept(fleet):
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    with started([*dask, "--no-dashboard", "--scheduler-file", "scheduler.json"], fleet) as scheduler:
        while not (fleet / "scheduler.json").exists():  # conftest.py ends a test that waits for ever
            time.sleep(0.1)
        address = json.loads((fleet / "scheduler.json").read_text())["address"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]

        def kill():
            wait_for_results(fleet, 3)
            scheduler.kill()

        with started(worker, fleet), killing(fleet, kill):
            done = convert(fleet, "--scheduler", address)
    assert done.returncode == 2
    assert "the Dask scheduler went away" in done.stderr
    assert "Traceback" not in done.stderr
    assert convert(fleet).returncode == 0
    assert_complete(fleet, is_clean=False)


def test_progress_is_a_bar_on_a_terminal_and_a_line_at_the_end_elsewhere(make_capture, tmp_path):
    make_capture("large.pcap", motor=[motor_row(n) for n in range(3000)])
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    command = ["convert", "large.pcap", "--to", "parquet", "--out", "data", "--tshark", FAKE]
    done = subprocess.run([sys.executable, "-m", "yapp_tables", *command], cwd=tmp_path, stderr=theirs, check=False)
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    assert done.returncode == 0, shown
    assert re.search(r"100%.* 1/1 \[", shown)
    again = run_tables(tmp_path, *command)
    assert again.stderr == "yapp-tables: 1 capture, 3,001 rows in data\n"
