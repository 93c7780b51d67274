# SPDX-License-Identifier: GPL-2.0-or-later
"""What recorders do to time stamps: they give all packets the same one."""
import json
import re

import pytest

import flights
import tshark

CASES = tshark.CAPTURES / "cases"
EQUAL = ("all packets of this capture have the same time stamp: how long faults, gaps and silences lasted is not known, "
         "and a message that was recorded twice counts twice")
FLIGHT = flights.make(3)
CLEAN = flights.make(5, True)


def z(path, what, *arguments):
    done = tshark.run("-q", "-r", path, *arguments, "-z", f"yapp,{what}", check=False)
    return done.returncode, done.stdout, done.stderr


def test_c01_hw_stamps_zero_motor_dead():
    """candump -H on an adapter without a hardware clock; Motor Data stops after 16 messages."""
    code, printed, _ = z(CASES / "c01_hw_stamps_zero_motor_dead.log", "check,silence=0,motor.gap=0.3")
    assert code == 21 and EQUAL in printed
    assert len(re.findall("NOT JUDGED  (?:silence=0|motor.gap=0.3)", printed)) == 4


def test_c01_hw_stamps_zero():
    """The same as screen text, with a fault of one second."""
    code, printed, said = z(CASES / "c01_hw_stamps_zero.txt", "faults,json")
    rows = [json.loads(line) for line in printed.splitlines()]
    assert code == 0 and [(row["event"], row["active"]) for row in rows] == [("raised", None), ("cleared", None)]
    assert EQUAL in said


@pytest.mark.parametrize("stamp", ["0000000000.000000", "1700000000.250000"])
def test_no_fault_is_missed(folder, stamp):
    """A flight with many faults: their order stays, how long they lasted is not known."""
    path = folder / "flight.log"
    FLIGHT.write(path, "candump")
    text, count = re.subn(r"(?m)^\(\d+\.\d+\)", f"({stamp})", path.read_text())
    assert count > 1000
    path.write_text(text)
    _, printed, said = z(path, "faults,json", *FLIGHT.arguments("candump"))
    rows = [json.loads(line) for line in printed.splitlines()]
    truth = FLIGHT.truth("candump")["faults"]
    keys = ("frame", "bus", "id", "field", "flag", "event")
    assert truth and [[row[key] for key in keys] for row in rows] == [[fault[key] for key in keys] for fault in truth]
    assert {row["active"] for row in rows} == {None} and EQUAL in said
    code, printed, _ = z(path, "check,silence=0,stale=0,jump=0", *FLIGHT.arguments("candump"))
    assert code == 21 and not re.search("(?m)^(FAILED|ok) +(silence|stale|jump)", printed)


def test_what_was_recorded_twice_counts_twice(folder):
    """Without times nothing tells a copy from a controller that repeats its bytes: the answer says it."""
    counts = []
    for copies in (1, 2):
        path = folder / f"{copies}.log"
        CLEAN.write(path, "candump")
        lines = re.sub(r"(?m)^\(\d+\.\d+\)", "(0000000000.000000)", path.read_text()).splitlines()
        path.write_text("".join(f"{line}\n" * copies for line in lines))
        code, printed, said = z(path, "summary,json", *CLEAN.arguments("candump"))
        counts.append([json.loads(line)["count"] for line in printed.splitlines()])
        assert code == 0 and EQUAL in said
    assert sum(counts[0]) > 100 and counts[1] == [2 * count for count in counts[0]]


@pytest.mark.parametrize("ahead", [(0, 9, 4), (3, 0, 1), (0, 7.4, 2), (5, 0, 1)], ids=str)
def test_a_recorder_for_each_message(folder, ahead):
    """One adapter's clock is seconds ahead of the next one's: nobody is silent, at no time and not to the end."""
    path = folder / "flight.log"
    CLEAN.write(path, "candump")
    lines = []
    for line in path.read_text().splitlines():
        stamp, bus, data = line.split()[:3]
        lines.append(f"({float(stamp[1:-1]) + ahead[(int(data[:8], 16) >> 18) % 3]:.6f}) {bus} {data}\n")
    path.write_text("".join(lines))
    arguments = CLEAN.arguments("candump")
    _, printed, _ = z(path, "events,json", *arguments)
    assert {json.loads(line)["kind"] for line in printed.splitlines()} == {"clock"}
    code, printed, _ = z(path, "check", *arguments)
    assert code == 20 and re.findall(r"(?m)^FAILED +(\S+)", printed) == ["clock=0"]
