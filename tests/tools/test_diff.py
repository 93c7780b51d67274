# SPDX-License-Identifier: GPL-2.0-or-later
"""Two runs compared: what is planted is found with its size, equal runs are equal, and what cannot be compared is said.

All pairs: pairs.py 0 100.
"""

import json
import math
import re
import struct
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pairs
import pytest
from running import PLUGIN, run_tables
from yapp_tables.changes import change, more_often
from yapp_tables.diff import Pair, Run, _intervals
from yapp_tables.series import Samples


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """before, equal but for seed and weather; after, with three planted changes, each of another controller."""
    folder = tmp_path_factory.mktemp("runs")
    pairs.write(folder / "before.pcapng", "a")
    pairs.write(folder / "equal.pcapng", "b")
    changes = {0: {"current": 0.03, "size": 2}, 1: {"lag": 40.0, "jitter": 1.0}, 2: {"temperature": 4.0}}
    pairs.write(folder / "after.pcapng", "c", changes | {3: {"cpu": 10.0, "flag": 0.014}})
    return folder


def diff(folder, *arguments, options=pairs.OPTIONS):
    done = run_tables(folder, "diff", *arguments, "--plugin", PLUGIN, *options)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_equal_runs(runs):
    done = diff(runs, "before.pcapng", "equal.pcapng")
    assert (done.returncode, "worse:" in done.stdout) == (0, False), done.stdout
    assert re.search(r"(?m)^0 worse, .* comparisons$", done.stdout)


def test_what_is_planted_is_found_with_its_size_and_nothing_else(runs):
    done = diff(runs, "before.pcapng", "after.pcapng", "--json", "--junit", "r.xml", "--out", "page.html")
    *rows, verdict = map(json.loads, done.stdout.splitlines())
    assert (done.returncode, verdict["code"], verdict["comparable"]) == (20, 20, True)
    whose = {"current": "fl", "size": "fl", "lag": "fr", "jitter": "fr", "temperature": "rl", "cpu": "rr", "flag": "rr"}
    for kind, who in whose.items():
        assert pairs.is_found(kind, who, rows), (kind, done.stdout)
    worse = {(row["controller"], row["measure"]) for row in rows if row["kind"] == "worse"}
    assert len(worse) == 8, worse  # the current of the motor comes with that of the supply
    for row in rows:
        if row["kind"] == "worse" and row["low"] is not None:
            assert row["low"] <= row["change"] <= row["high"], row
            assert row["before_frame"], row
            assert row["after_frame"], row
    suite = ElementTree.parse(runs / "r.xml").getroot()
    assert (suite.get("failures"), len(suite.findall("testcase/failure"))) == ("8", 8)
    page = (runs / "page.html").read_text()
    assert "BEFORE, A" in page
    assert "://" not in page
    values = 4 + 1 + 2  # of Motor Data in A (an error, too), W and °C
    for name in ("fl", "fr", "rl", "rr"):
        assert page.count(f"<h3>{name}: ") == values
    assert page.count("<table") == 4 * values


@pytest.mark.parametrize(
    ("before", "after", "options", "reason"),
    [
        ("short.pcapng", "equal.pcapng", pairs.OPTIONS, "BEFORE lasts 9"),
        ("before.pcapng", "slow.pcapng", pairs.OPTIONS, "too few loads in common"),
        ("before.pcapng", "still.pcapng", pairs.OPTIONS, "no motor turned in AFTER"),
        ("before.pcapng", "can0.pcapng", pairs.OPTIONS, "the controllers differ: rl (Motor Data) is in BEFORE only"),
    ],
)
def test_what_cannot_be_compared_is_said(runs, monkeypatch, before, after, options, reason):
    if not (runs / "slow.pcapng").exists():
        pairs.write(runs / "short.pcapng", "s", seconds=10)
        with monkeypatch.context() as patch:
            patch.setattr(pairs.Weather, "command", lambda _self, time: 500 + time)
            pairs.write(runs / "slow.pcapng", "d", seconds=40)
            patch.setattr(pairs.Weather, "command", lambda _self, _time: 0.0)
            pairs.write(runs / "still.pcapng", "d", seconds=40)
            run = pairs.Motor.run
            patch.setattr(pairs.Motor, "run", lambda self, *given: run(self, *given) if self.number < 2 else ())
            pairs.write(runs / "can0.pcapng", "e", seconds=40)
    done = diff(runs, before, after, "--junit", "r.xml", options=options)
    assert (done.returncode, f"not comparable: {reason}" in done.stdout) == (21, True), done.stdout
    assert reason in (runs / "r.xml").read_text()


def test_what_was_not_decoded_is_no_all_clear(runs):
    done = diff(runs, "before.pcapng", "equal.pcapng", options=("-o", "yapp.motor_ids:0x210,0x211"))
    assert done.returncode == 21
    assert "BEFORE: " in done.stdout
    assert "Try -o yapp.health_ids" in done.stdout


def test_rules_are_judged_on_both(runs):
    (runs / "flight.rules").write_text(
        "source=rl\nmotor.motor_temperature=..200\nsource=rr\nmotor.count=5000\nfault=9\n"
    )
    done = diff(runs, "before.pcapng", "after.pcapng", "--rules", "flight.rules")
    assert re.search("worse: .*: rule fault=9 held, now did not hold", done.stdout)
    assert "motor_temperature=..200" not in done.stdout


def test_a_sensor_that_fails_is_worse(runs, monkeypatch):
    run, zero = pairs.Motor.run, struct.pack("<H", pairs.flights.count(0, *pairs.AMPERES))

    def blind(motor, *given):
        for at, bus, ident, payload in run(motor, *given):
            is_one = ident == 0x210 and motor.number == 0
            yield at, bus, ident, payload[:10] + zero + payload[12:] if is_one else payload

    monkeypatch.setattr(pairs.Motor, "run", blind)
    pairs.write(runs / "blind.pcapng", "f")
    *rows, verdict = map(json.loads, diff(runs, "before.pcapng", "blind.pcapng", "--json").stdout.splitlines())
    worse = [(row["controller"], row["measure"]) for row in rows if row["kind"] == "worse"]
    assert worse == [("fl", "absent values of DC Current")]
    assert verdict["notes"][-1] == "not compared, with too few numbers or with both signs: DC Current of fl"


def test_a_larger_jitter_is_no_other_rate():
    rng, numbers = np.random.default_rng(1), np.arange(1500)
    times = [numbers / 10 + rng.normal(0, jitter, 1500) for jitter in (0.02, 0.002)]
    sides = [Samples("m", "m", "motor", "Motor", 0.1, {}, own, numbers, {}, set()) for own in times]
    run = Run("", [SimpleNamespace(name="")])
    rate, jitter = _intervals(Pair((run, run), tuple(sides)))
    assert abs(rate.change.value) < 0.005
    assert jitter.change.value == pytest.approx(math.log(0.1), abs=0.2)


def test_several_captures_of_a_side(runs, tmp_path):
    for name in ("before", "equal"):
        (tmp_path / "all").mkdir(exist_ok=True)
        (tmp_path / f"all/{name}.pcapng").write_bytes((runs / f"{name}.pcapng").read_bytes())
    done = diff(tmp_path, "all", "all/*.pcapng")
    assert done.returncode == 0
    assert "BEFORE: before.pcapng, equal.pcapng, 20" in done.stdout
    done = diff(tmp_path, "none.pcapng", "all")
    assert (done.returncode, "no such file" in done.stderr) == (1, True)


def noise(rng, count, keep=0.9):
    """Values of which each is like the one before."""
    values = np.zeros(count)
    for at in range(1, count):
        values[at] = keep * values[at - 1] + rng.normal()
    return values


def test_the_interval_holds_what_it_promises():
    """Of 200 comparisons of equal runs of dependent values, about 5 % lie outside."""
    rng, outside = np.random.default_rng(3), 0
    times = np.concatenate([np.arange(1500) / 10, 1e6 + np.arange(1500) / 10])
    is_after = times > 1e5
    for _ in range(200):
        load = rng.normal(size=(3000, 2))
        values = np.concatenate([noise(rng, 1500), noise(rng, 1500)]) + load @ [3, -2] + 0.5 * is_after
        low, high = change(times, values, is_after, load).within()
        outside += not low < 0.5 < high
    assert 2 <= outside <= 24, outside


@pytest.mark.parametrize(
    ("before", "after", "chance"), [(0, 0, 1), (0, 5, 1 / 32), (5, 5, 0.623), (3, 20, 0.000244), (20, 3, 0.99998)]
)
def test_more_often(before, after, chance):
    assert more_often(before, after, 0.5) == pytest.approx(chance, rel=0.01)
