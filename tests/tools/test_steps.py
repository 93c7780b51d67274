# SPDX-License-Identifier: GPL-2.0-or-later
"""Steps and operating points of a known controller, and the log of a thrust stand beside them."""

import csv
import math
import random

import numpy as np
import pytest
from yapp_tables import steps
from yapp_tables.errors import CaptureError, SetupError
from yapp_tables.series import Samples


def controller(changes, tau=0.2, dead=0.05, every=0.1, seconds=40.0, overshoot=0.0, offset=0.0):
    """A controller that follows changes [(time, speed)] with a known response, its times jittered by the recorder."""
    rng = np.random.default_rng(1)
    clock = np.arange(0.03, seconds, every)
    told, value = np.zeros(len(clock)), np.zeros(len(clock))
    for at, (begin, target) in enumerate(changes):
        before = changes[at - 1][1] if at else 0.0
        since = clock - begin - dead
        there = since >= 0
        answer = 1 - np.exp(-since / tau) * (
            1 - overshoot * np.sin(math.pi * np.clip(since, 0, 1)) * np.exp(since / tau)
        )
        value[there] = before + (target - before) * answer[there] + offset
        told[clock >= begin] = target
    about = {"rpm_commanded": {"unit": "RPM", "role": "value"}, "rpm_measured": {"unit": "RPM", "role": "value"}}
    about |= {"heat": {"unit": "°C", "role": "value"}, "clock": {"unit": "s", "role": "clock"}}
    columns = {"rpm_commanded": told, "rpm_measured": value, "heat": 20 + clock / 30, "clock": clock + 500}
    times = clock + rng.uniform(0, 0.01, len(clock))
    motor = Samples("m", "m", "motor", "Motor", every, about, times, np.arange(len(clock)), columns, {("can0", 0x210)})
    when = np.arange(0, seconds, 0.02)
    rpm = np.array([next((rpm for at, rpm in reversed(changes) if at <= now), 0.0) for now in when])
    known = {"rpm": {"unit": "RPM", "role": "value"}}
    command = Samples("can0 0x000", "can0 0x000 Command", "command", "Command", 0.02, known, when,
                      np.arange(len(when)), {"rpm": rpm}, {("can0", 0)})  # fmt: skip
    return {("m", "motor"): motor, ("can0 0x000 Command", "command"): command}


CHANGES = [(2.0, 2000.0), (10.0, 4000.0), (20.0, 3000.0), (30.0, 3040.0)]


def test_steps_of_a_known_response():
    found = list(steps.steps(controller(CHANGES, offset=7.0)))
    assert [(row["before"], row["after"]) for row in found] == [(0, 2000), (2000, 4000), (4000, 3000)]  # 40 is no step
    for row in found:
        assert row["dead_time"] == pytest.approx(0.05 + 0.2 * math.log(1 / 0.9), abs=0.04)
        assert row["lag"] == pytest.approx(0.25, abs=0.03)
        assert row["rise_time"] == pytest.approx(0.2 * math.log(9), abs=0.06)
        assert row["settling_time"] == pytest.approx(0.05 + 0.2 * math.log(20), abs=0.12)
        later = 40 if row["after"] == 3000 else 0  # too little to be a step
        assert row["final_error"] == pytest.approx(7.0 + later, abs=0.5)
        assert row["overshoot"] < 0.01
        assert row["resolution"] == 0.1


def test_overshoot_and_what_never_settles():
    (row,) = list(steps.steps(controller([(2.0, 2000.0)], tau=0.05, overshoot=0.3)))
    assert row["overshoot"] == pytest.approx(0.3, abs=0.03)
    short = list(steps.steps(controller([(2.0, 2000.0), (2.7, 3000.0), (2.9, 1000.0)], tau=3.0)))
    assert [(row["after"], row.get("settling_time")) for row in short] == [
        (2000, None),
        (1000, pytest.approx(11, abs=3)),
    ]


def test_points_are_the_holds():
    found = list(steps.points(controller(CHANGES)))
    assert [row["command"] for row in found] == pytest.approx([2000, 4000, 3000 + 40 * 10 / 20], rel=0.01)
    for row, (_, speed) in zip(found, CHANGES[:3], strict=True):
        assert row["rpm_measured"] == pytest.approx(speed, rel=0.02)
        assert row["heat_slope"] == pytest.approx(2.0, abs=0.01)
    assert [row["length"] for row in found] == pytest.approx([8, 10, 20], abs=0.1)


def log_of(path, found, offset, ppm=0.0, noise=5.0, cut=(0.0, 99.0), factor=1.0):
    """Write the log of a stand whose clock began `offset` seconds after the capture's, 20 rows a second."""
    rng, motor = random.Random(2), found["m", "motor"]
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["Time (s)", "Motor Electrical Speed (RPM)", "Thrust (kgf)", "Note"])
        for tick in range(int(cut[0] * 20), int(min(cut[1], 39) * 20)):
            own = tick / 20
            at = offset + own * (1 + ppm / 1e6)
            speed = float(np.interp(at, motor.times, motor.columns["rpm_measured"])) * factor
            rows.writerow([f"{own:.3f}", f"{speed + rng.gauss(0, noise):.1f}", f"{speed**2 * 1e-7:.5f}", "ok"])
    return path


@pytest.mark.parametrize(("offset", "ppm", "factor"), [(3.217, 0, 1), (-4.55, 300, 7), (0.0, -200, 1)])
def test_a_bench_is_aligned_by_its_speed(tmp_path, offset, ppm, factor):
    found = controller([(4.0, 2000.0), (11.0, 4000.0), (19.0, 3000.0), (27.0, 3900.0), (34.0, 900.0)])
    log = steps.aligned(log_of(tmp_path / "bench.csv", found, offset, ppm, factor=factor), found)
    assert log.controller == "m"
    true = offset + np.arange(len(log.times)) / 20 * (1 + ppm / 1e6)
    assert np.abs(log.times - true).max() < 0.06
    assert set(log.columns) == {"bench_motor_electrical_speed_rpm", "bench_thrust_kgf"}
    assert f"{offset:+.1f}"[:4] in log.said or offset == 0
    rows = list(steps.points(found, log))
    # The last second of a log that begins earlier is of no hold.
    whole = [row for row in rows if row["bench_thrust_kgf"] is not None]
    assert len(whole) >= 4
    for row in whole:
        assert row["bench_thrust_kgf"] == pytest.approx((row["rpm_measured"] * factor) ** 2 * 1e-7, rel=0.03)


@pytest.mark.parametrize(
    ("changes", "cut", "said"),
    [
        ([(5.0 + 5 * n, 3000.0 if n % 2 else 2000.0) for n in range(6)], (10.0, 22.0), "ambiguous, offsets of"),
        (CHANGES, (0.0, 99.0), "fits no controller"),
    ],
)
def test_what_fits_twice_or_not_at_all_is_refused(tmp_path, changes, cut, said):
    found = controller(changes)
    path = log_of(tmp_path / "bench.csv", found, 0.0, cut=cut)
    if "no controller" in said:
        path = log_of(path, controller([(3 * n, random.Random(n).uniform(500, 4000)) for n in range(12)]), 0.0)
    with pytest.raises(CaptureError, match=said):
        steps.aligned(path, found)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        *((text, "is no log of a bench: it needs 20 rows, a column of time") for text in (
            "a,b\n" + "1,2\n" * 30, "time,b\n" + "1,2\n" * 30, "time,rpm\n1,1\n", "time,rpm\n" + "x,1\n" * 30)),
        ("time,rpm\n" + "1,2\n" * 30, "'time' has to rise, to 0 s"),
        ("time,rpm\n" + "".join(f"{n % 20},2\n" for n in range(30)), "'time' has to rise, to 19 s"),
        ("time,rpm\n" + "".join(f"{n}000000,2\n" for n in range(30)), "name the unit, as in time_ms"),
        ("time,rpm,rpm\n" + "1,2,3\n" * 30, "cannot be read: .*2 times"),
    ],
)  # fmt: skip
def test_what_is_no_log(tmp_path, text, said):
    (tmp_path / "bench.csv").write_text(text)
    with pytest.raises(SetupError, match=said):
        steps.read(tmp_path / "bench.csv")


@pytest.mark.parametrize(
    ("time", "unit", "mark"),
    [("t_ms", 1000, ";"), ("Zeit", 1, "\t"), ("time [min]", 1 / 60, ","), ("t (µs)", 1e6, ";")],
)
def test_a_log_has_its_own_units_and_commas(tmp_path, time, unit, mark):
    rows = [mark.join([f"{number * 0.05 * unit:.6f}", f"{number}.5", "20.25"]) for number in range(40)]
    text = "\n".join([mark.join([time, "rpm", "°C"]), *rows])
    (tmp_path / "bench.csv").write_text(text if mark == "," else text.replace(".", ","), encoding="latin-1")
    times, speed, columns = steps.read(tmp_path / "bench.csv")
    assert times == pytest.approx(np.arange(40) * 0.05, abs=1e-4)
    assert speed == pytest.approx(np.arange(40) + 0.5)
    assert set(columns["bench_c"]) == {20.25}
