# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits learnt from good flights: other good flights keep them, each flight with a planted deviation does not."""

import json
import math
import random
import re
import struct
import subprocess

import aircraft
import flights
import numpy as np
import pytest
from running import PLUGIN, run_tables
from yapp_tables import baseline
from yapp_tables.series import Samples

KIND = "worn"  # four controllers, one of which is worn
OPTIONS = aircraft.options(KIND)


def judge(path, rules):
    """Return the exit code, and the names of the rules that do not hold."""
    answer = f"yapp,check,rules={rules},json"
    command = ["tshark", "-q", "-r", path, "-X", f"lua_script:{PLUGIN}", *OPTIONS, "-z", answer]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert rows, done.stderr
    return done.returncode, [f"{row['source'] or ''} {row['rule']}" for row in rows if row["ok"] is not True]


def learn(folder, *arguments, code=0, options=OPTIONS):
    command = ["baseline", *arguments, "--out", "flight.rules", "--plugin", PLUGIN, *options]
    return run_tables(folder, *command, code=code).stderr


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A folder with ten good flights, and what was learnt from them."""
    folder = tmp_path_factory.mktemp("good")
    names = [aircraft.write(folder / f"good{seed}.pcapng", KIND, seed).name for seed in range(10)]
    learn(folder, *names)
    return folder


def test_good_flights_keep_them(learnt, tmp_path):
    for seed in (0, 5):
        assert judge(learnt / f"good{seed}.pcapng", learnt / "flight.rules") == (0, [])
    for seed in (50, 53):
        path = aircraft.write(tmp_path / "other.pcapng", KIND, seed)
        assert judge(path, learnt / "flight.rules") == (0, []), seed


@pytest.mark.parametrize("defect", aircraft.DEFECTS)
def test_a_defect_does_not(learnt, tmp_path, defect):
    path = aircraft.write(tmp_path / "bad.pcapng", KIND, 60 + aircraft.DEFECTS.index(defect), defect)
    code, broken = judge(path, learnt / "flight.rules")
    assert code == 20, broken


def test_what_stands_in_the_file(learnt):
    """A controller has its own limits, and each says whose the extremes are."""
    text = (learnt / "flight.rules").read_text()
    assert all(f"\nsource=m{number}\n" in text for number in range(4))
    assert "\nabsent=0\nunknown=0\n" in text
    low, high, lowest, at_low, highest, at_high = re.search(
        r"motor\.dc_voltage=(.*)\.\.(.*?) +# (.*) in (good\d\.pcapng), (.*) in (good\d\.pcapng)", text
    ).groups()
    assert float(low) < float(lowest) < float(highest) < float(high)
    export = ["tshark", "-q", "-r", learnt / at_low, "-X", f"lua_script:{PLUGIN}", *OPTIONS, "-z", "yapp,summary,json"]
    done = subprocess.run(export, capture_output=True, text=True, check=True)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert float(lowest) in {row["values"].get("dc_voltage", {}).get("min") for row in rows}
    assert at_high
    speed = [f"{name}.over(rpm_measured)=" for name in ("dc_current", "dc_power", "torque_iq_measured")]
    for rule in (*speed, "motor_temperature.over(dc_current)=", "rpm_error.noise="):
        assert re.search(rf"^motor\.{re.escape(rule)}.* # .* in good\d", text, re.M), rule


def test_fields_with_the_names_of_measures(tmp_path, monkeypatch):
    """The rate of the messages is 10 Hz, the field of this name 1000 to 1009."""
    names = ("rate", "gap", "mean", "spread")
    fields = ", ".join(f'{{ "{name}", "uint16", "{name.title()}", unit = "V" }}' for name in names)
    fields += ', derived = { { "drop", "rate - gap", "Drop", unit = "V" } }'  # a column, as it has a unit of its own
    (tmp_path / "messages.lua").write_text(
        f'return {{ {{ name = "pump", title = "Pump", id = 0x340, size = 8, {fields} }} }}'
    )
    monkeypatch.setenv("YAPP_MESSAGES", str(tmp_path / "messages.lua"))
    for capture in ("a", "b"):
        frames = [
            f"({n / 10:.6f}) can0 {0x340 << 18 | n:08X}#{struct.pack('<4H', 1000 + n % 10, 50, n, 7).hex()}\n"
            for n in range(100)
        ]
        (tmp_path / f"{capture}.log").write_text("".join(frames))
    learn(tmp_path, "a.log", "b.log", options=("-o", "yapp.pump_ids:0x340"))
    text = (tmp_path / "flight.rules").read_text()
    learnt = {name: ends for name, *ends in re.findall(r"^pump\.([\w.]+)=(?:(.+?)\.\.)?(\S+) ", text, re.M)}
    assert learnt.keys() == {"rate", "gap", "rate.value", "gap.value", "mean", "spread"} | {
        f"{name}.mean" for name in ("rate", "gap", "mean", "spread")
    } | {"drop", "drop.mean"}
    expected = {"rate": (10, 10), "rate.value": (1000, 1009), "rate.mean": (1004.5, 1004.5), "mean": (0, 99)}
    for name, (lowest, highest) in expected.items():
        low, high = map(float, learnt[name])
        assert lowest - 30 < low <= lowest <= highest <= high < highest + 30, name


def test_without_names(learnt, tmp_path):
    """Rules are about all controllers then."""
    options = OPTIONS[:2]
    learn(tmp_path, learnt / "good0.pcapng", learnt / "good1.pcapng", options=options)
    narrow = (tmp_path / "flight.rules").read_text()
    assert "source=" not in narrow
    assert "# absent=0: good1.pcapng does not keep it (no source is named" in narrow


def test_what_happens_in_good_flights_may_happen(tmp_path):
    """This flight has faults, a reboot and lost messages: as many, and a bit more, are good."""
    flights.write(tmp_path / "a.pcapng", 5, 60)
    options = [word for option in flights.OPTIONS for word in ("-o", option)]
    learn(tmp_path, "a.pcapng", options=options)
    text = (tmp_path / "flight.rules").read_text()
    assert re.search(r"^motor\.rpm_measured=", text, re.MULTILINE)
    for rule in ("fault", "reboot", "silence", "incomplete"):
        (limit, seen) = re.search(rf"^{rule}=(\d+) +# (\d+) in a\.pcapng$", text, re.MULTILINE).groups()
        assert int(limit) >= int(seen) > 0


def test_what_is_left_out_is_said(tmp_path):
    flights.write(tmp_path / "a.pcapng", 5, 20)
    said = learn(tmp_path, "a.pcapng", options=(), code=3)
    assert "a.pcapng: " in said
    assert "not decoded" in said
    assert "yapp.motor_ids" in said


@pytest.mark.parametrize(
    ("cut", "code", "text"), [(40_000, 1, "cut short"), (24, 1, "no YAPP messages"), (0, 1, "no such file")]
)
def test_what_no_limits_can_be_learnt_from(learnt, tmp_path, cut, code, text):
    content = (learnt / "good0.pcapng").read_bytes()
    if cut == 24:
        (tmp_path / "a.pcapng").write_bytes(bytes.fromhex("d4c3b2a1 0200 0400 00000000 00000000 00000100 e3000000"))
    elif cut:
        (tmp_path / "a.pcapng").write_bytes(content[:cut])
    assert text in learn(tmp_path, "a.pcapng", code=code)
    assert not (tmp_path / "flight.rules").exists()


def samples_of(x, y):
    about = {name: {"role": "value"} for name in "xy"}
    columns = {"x": np.array(x, float), "y": np.array(y, float)}
    times = np.arange(len(x)) / 10
    return Samples("left", "left", "m", "M", 0.1, about, times, np.arange(len(x)), columns, {("can0", 0x210)})


@pytest.mark.parametrize("seed", range(20))
def test_what_lasts(seed):
    """Of each stretch so long its least value, of these the largest; a gap ends it, a reserved value does not."""
    rng, length = random.Random(seed), random.Random(seed).randrange(5)
    values = [rng.choice([math.nan, *range(9), *range(9)]) for _ in range(40)]
    one = samples_of(values, values)
    one.times[20:] += 1
    stretches = []
    for begin, end in ((0, 20), (20, 40)):
        kept = [at for at in range(begin, end) if values[at] == values[at]]
        for place, at in enumerate(kept):
            last = next((other for other in kept[place:] if other - at >= length), None)
            if last is not None:
                stretches.append([values[other] for other in kept if at <= other <= last])
    assert baseline.held(one, one.columns["x"], length, 0.1, np.zeros(40, bool)) == max(map(min, stretches))


def test_limits_over_another_field():
    """y is x squared, and a bit more or less in each flight: limits lie beyond that, and hold at each point."""
    rng, found = random.Random(3), []
    for number in range(10):
        x = [15 + 5 * math.sin(at / 40 + rng.random()) for at in range(600)]
        found.append((f"f{number}", samples_of(x, [at**2 * (1 + 0.01 * (number - 5) / 5) for at in x])))
    (finding,) = baseline._over("m", found, ("y", "x"), (10, 0.1))
    assert (finding.what, len(finding.found)) == ("m.y.over(x)", 10)
    low, high = (fold(end for row in finding.found for end in row[:2]) for fold in (min, max))
    text = finding.write(str(low), str(high))
    assert text.startswith("m.y.over(x)=")
    assert " when=x=" in text
    assert text.endswith(" after=1 for=1")
    points = [re.fullmatch(r"(.*):(.*)\.\.(.*)", part).groups() for part in text[12:].partition(" ")[0].split(";")]
    assert len(points) == baseline.POINTS
    for at, bottom, top in (map(float, point) for point in points):
        assert at**2 * 0.9 < bottom < at**2 < top < at**2 * 1.1
    assert baseline._having(found[:2], "y") == []


def test_a_rule_is_tried_on_flights_that_have_no_part_in_it():
    """Nine flights show 1; one shows 100, which limits of the others do not cover: the rule is a comment."""
    alike = [(1.0, 1.0, f"flight{number}") for number in range(9)]
    for more, lost in (([], ""), ([(100.0, 100.0, "odd")], "flights differ too much: 1 of 10 do not keep it")):
        one = baseline.Finding("", "m.x.mean", alike + more)
        assert baseline._rule(one, one.found, (0.0, 0.0)).lost == lost
