# SPDX-License-Identifier: GPL-2.0-or-later
"""What recorders and converters write: each line is a frame, known, or counted as lost; each value is what was sent."""
import csv
import json
import random
from decimal import Decimal

import pytest

import asc
import flights
import levels
import tshark
from test_statistics import check_row, seconds

pytestmark = levels.by_version
CASES = tshark.CAPTURES / "cases"
PASSES = [(), ("-2",)]


def events(path, *arguments):
    """The events of a capture, and the exit code of check."""
    done = tshark.run("-r", path, *arguments, "-q", "-z", "yapp,events,json", check=False)
    return [json.loads(line) for line in done.stdout.splitlines()]


# File: number of Motor Data, how often a fault is raised and cleared, exit code of check.
FILES = {
    "c02_asc_lower_rx.asc": (12, ["raised", "cleared"], 20),
    "c02_asc_negative_times_fault.asc": (20, ["raised", "cleared"], 20),
    "c03_asc_upper_D_decimal.asc": (12, ["raised", "cleared"], 20),
    "c04_busmaster.asc": (12, ["raised", "cleared"], 20),
    "c06_fd_single_hash.log": (12, ["raised", "cleared"], 20),
    "c06_two_buses_truth.log": (24, ["raised", "cleared"], 20),
    "c09_canxl.log": (12, [], 0),
    "c12_usec_overflow.log": (30, ["raised", "cleared"], 20),
}


@pytest.mark.parametrize("name", FILES)
def test_files(name):
    count, changes, code = FILES[name]
    path = CASES / name
    done = tshark.run("-r", path, "-q", "-z", "yapp,events,json", "-z", "yapp,csv,-,motor", "-z", "yapp,check", check=False)
    assert sum(line[:1].isdigit() and ".0" in line for line in done.stdout.splitlines()) == count
    found = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [event["event"] for event in found if event["kind"] == "fault"] == changes
    assert {event["kind"] for event in found} == ({"fault"} if changes else set())
    assert done.returncode == code


@levels.each_once
@pytest.mark.parametrize("passes", PASSES, ids=len)
@pytest.mark.parametrize("seed", range(1, levels.size(4, 25)))
def test_every_dialect_of_asc(folder, seed, passes):
    """Every value of a flight, every bus and every time; no loss but the lines that are damaged."""
    rng = random.Random(f"asc {seed}")
    flight = flights.make(seed)
    log = asc.Log(rng, flight, rng.choice([0, 0, 1, 5]))
    path, table = folder / "flight.asc", folder / "table"
    path.write_text(log.text, newline="")
    done = tshark.run(*flight.arguments("asc"), *passes, "-q", "-r", path, "-z", f"yapp,csv,{table}", "-z", "yapp,events,json",
                      env={"TZ": "UTC"})
    dropped = [json.loads(line) for line in done.stdout.splitlines() if '"dropped"' in line]
    assert sum(event["count"] for event in dropped) == log.lost, (log.head, done.stderr)
    assert done.stderr.count("ASC reader: line") >= min(log.lost, 1)
    shift = None if log.has_date() else "unknown"
    for kind, expected in flight.rows("asc").items():
        with open(table / f"{kind}.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == len(expected)
        for row, (frame, bus, source, message) in zip(rows, expected):
            behind = Decimal(row["time"]) - seconds(frame.at)
            shift = behind if shift == "unknown" else shift
            assert abs(behind - (shift or 0)) < Decimal("0.000002"), (log.head, row["time"], seconds(frame.at))
            row["time"] = f"{frame.at // flights.SECOND}.{frame.at % flights.SECOND:09d}"
            check_row(row, frame, bus, source, message)
