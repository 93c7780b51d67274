# SPDX-License-Identifier: GPL-2.0-or-later
"""The command as a user runs it, and rows for the stand-in of tshark."""

import concurrent.futures
import contextlib
import os
import subprocess
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "tools"))
import bundle

TOP = Path(__file__).parents[2]
PLUGIN = os.environ.get("YAPP_PLUGIN", TOP / "yapp.lua")
FAKE = Path(__file__).with_name("fake_tshark.py")


def motor_row(number, **cells):
    """The row of a Motor Data message, ten a second, all cells as the plugin's CSV has them."""
    row = {
        "time": f"{1_700_000_000 + number // 10}.{number % 10}00000001", "frame": str(5 * number + 5), "bus": "can0",
        "source": "", "id": "528", "seq": str(number % 256),
        "rpm_measured": f"{1000 + number}.5", "rpm_measured_special": "",
        "motor_mode": "1", "motor_mode_text": "Speed Mode", "fault_flags": "0", "fault_motor_overcurrent": "0",
        "timestamp": f"{number // 10}.{number % 10}00000000", "serial": "18446744073709551615", "revision": "3",
    }  # fmt: skip
    return row | cells


def wait_for_results(folder, count):
    """Wait until a run has written so many results; fail after two minutes."""
    until = time.monotonic() + 120
    while len(list((folder / "data/message=motor").glob("*"))) < count:
        assert time.monotonic() < until, f"no {count} results in {folder}"
        time.sleep(0.01)


@contextlib.contextmanager
def started(command, folder):
    """Run a process; kill it at the end, whatever happened."""
    process = subprocess.Popen(list(map(str, command)), cwd=folder, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@contextlib.contextmanager
def killing(folder, kill):
    """Call kill() in a thread while a run is held, see fake_tshark.py; it must have ended when the run has."""
    hold = folder / "flights/hold"
    hold.touch()

    def at_work():
        try:
            kill()
        finally:
            hold.unlink()

    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        done = pool.submit(at_work)
        yield
        done.result(timeout=1)


def install_plugin(home):
    """Put the plugin where tshark looks for it in this home, in one file as an installation has it."""
    bundle.write(home / ".local/lib/wireshark/plugins/yapp", Path(PLUGIN).parent)


def run_tables(folder, *arguments, code=None, timeout=300, **options):
    """The command as a user runs it, in this folder; returns the finished process. code: which it must end with."""
    command = [sys.executable, "-m", "yapp_tables", *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout, **options)
    assert code in (None, done.returncode), done.stderr
    return done


def result(folder, name, suffix):
    """The one file of a capture's result: flight-1a2b3c4d.parquet of flight."""
    (path,) = folder.glob(f"{name}-????????{suffix}")
    return path
