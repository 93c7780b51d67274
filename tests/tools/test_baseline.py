# SPDX-License-Identifier: GPL-2.0-or-later
"""Limits learnt from good flights: other good flights keep them, each flight with a planted deviation does not.

test_baseline.py FOLDER judges 20 good ones and 28 others after 10 good ones.
"""

import json
import math
import random
import re
import struct
import subprocess
import sys
from collections import Counter
from pathlib import Path

import aircraft
import flights
import numpy as np
import pytest
from running import PLUGIN, run_tables
from yapp_tables import baseline
from yapp_tables.series import Samples

NAMES = {("can0", 0x210): "fl", ("can0", 0x211): "fr", ("can1", 0x210): "rl", ("can1", 0x211): "rr"}
SOURCES = ",".join(
    f"{bus}/{ident:#x}=motor:{name},{bus}/{ident - 16:#x}=health:{name}" for (bus, ident), name in NAMES.items()
)
OPTIONS = ("-o", "yapp.motor_ids:0x210,0x211", "-o", "yapp.health_ids:0x200,0x201", "-o", f"yapp.sources:{SOURCES}")
# A motor 12 °C hotter, a battery 4 V lower, a controller's voltage 1.2 V lower, 8.5 messages a second, half the speed
# in following the command; a reboot, an overcurrent of 0.5 s, a sensor that fails, a message that is lost; 30 % more
# current, five times the noise of the speed, a second without messages; 15 % more current.
# Each breaks a rule with this in it.
DEVIATIONS = {
    "hot": "motor_temperature", "battery": "dc_voltage", "voltage": "dc_voltage", "slow": "rate", "lag": "rpm_error",
    "reboot": "reboot=0", "overcurrent": "fault=0", "sensor": "motor_temperature.special=0.05",
    "lost": "incomplete=0", "current": "dc_current", "noise": "rpm_error", "silence": "silence=0",
    "worn": "dc_current.ratio",
}  # fmt: skip


def write(path, seed, deviation=None):
    """Write a flight of about a minute with four controllers, each a bit in its own way; one of them may deviate.

    In one of three flights, 1 % of the speeds are reserved values.
    """
    rng, pcap, length = random.Random(seed), flights.Pcapng(path), random.Random(f"length {seed}").uniform(40, 70)
    ambient, battery, phases = rng.gauss(18, 3), rng.gauss(50.2, 0.15), [rng.uniform(0, 6) for _ in range(3)]
    packets = []
    for number in range(4):
        odd = random.Random(f"reserved {seed} {number}") if seed % 3 == 1 else None
        packets += _controller(random.Random(f"{seed} {number}"), odd, number, length, ambient, battery, phases,
                               deviation if number == seed % 4 or deviation == "battery" else None)  # fmt: skip
    packets.sort()
    lost = len(packets) // 2 if deviation == "lost" else None
    for number, (time, bus, message, payload) in enumerate(packets):
        flights.send(pcap, time, bus, message, payload, lose=2 if number == lost else None)
    pcap.file.close()
    return path


def _controller(rng, odd, number, length, ambient, battery, phases, deviation):
    own, speed, time, share = rng.gauss(0, 0.6), 0.0, rng.uniform(0, 0.1), rng.uniform(0.55, 0.65)
    load, health, boot = rng.uniform(0.97, 1.03), 0.0, rng.randrange(10**12)
    load *= {"current": 1.3, "worn": 1.15}.get(deviation, 1)
    half, clock = length / 2, boot
    while time < length:
        flown = min(max(time - 3, 0) / 2, 1)
        wave = 300 * math.sin(time / 6 + phases[0]) + 200 * math.sin(time / 2.5 + phases[1])
        command = flown * (3600 + wave + 60 * math.sin(time / 7 + number + phases[2]))
        speed += (command - speed) * (share / 2.5 if deviation == "lag" else share)
        measured = speed + rng.gauss(0, 40 if deviation == "noise" else 8) * (speed > 0)
        current = (1 + (measured / 4000) ** 2 * 12 * load) + rng.gauss(0, 0.15)
        lower = {"battery": 4, "voltage": 1.2}.get(deviation, 0)
        voltage = battery - time * 0.05 - current * 0.04 - lower + rng.gauss(0, 0.02)
        heat = ambient + own + 25 * (1 - math.exp(-time / 20)) * load
        motor = heat + 4 + (12 * (1 - math.exp(-time / 8)) if deviation == "hot" else 0) + rng.gauss(0, 0.3)
        is_late = time > half
        if is_late and deviation == "reboot":
            clock = -int(half * 1e9)
        faults = flights.OVERCURRENT if deviation == "overcurrent" and 0 < time - half < 0.5 else 0
        state = 0x20 if faults else 2
        raw_motor = flights.NAN8 if is_late and deviation == "sensor" else flights.count(motor, -40, 210, 250)
        raw_speed = flights.count(measured, -60000, 60000, 65530)
        if odd and odd.random() < 0.01:
            raw_speed = flights.NAN16 - odd.randrange(5)
        amperes = flights.count(current, -128, 128, 65530)
        payload = struct.pack(
            "<6HBBIIqBB", amperes, amperes, flights.count(command, -60000, 60000, 65530),
            raw_speed, flights.count(voltage, -128, 128, 65530), amperes,
            raw_motor, 1, 0x12_0000, faults, clock + int(time * 1e9), state,
            flights.count(heat, -40, 210, 250),
        )  # fmt: skip
        at = flights.START + int(time * 1e9)
        if deviation == "silence" and 0 < time - half < 1:
            time += 0.1
            continue
        yield at, number // 2, 0x210 + number % 2, payload
        if time >= health:
            board = struct.pack("<q9B", clock + int(time * 1e9), 40 + rng.randrange(4), 50, 80, 85, 90, 3, 9, 1, 2)
            yield at + 2_000_000, number // 2, 0x200 + number % 2, board
            health += 0.5
        time += (0.1 / 0.85 if deviation == "slow" else 0.1) + rng.uniform(-0.003, 0.003)


def judge(path, rules, options=OPTIONS):
    """Return the exit code, and the names of the rules that do not hold."""
    command = [
        "tshark",
        "-q",
        "-r",
        path,
        "-X",
        f"lua_script:{PLUGIN}",
        *options,
        "-z",
        f"yapp,check,rules={rules},json",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert rows, done.stderr
    return done.returncode, [f"{row['source'] or ''} {row['rule']}" for row in rows if row["ok"] is not True]


def learn(folder, *arguments, code=0, options=OPTIONS):
    done = run_tables(folder, "baseline", *arguments, "--out", "flight.rules", "--plugin", PLUGIN, *options)
    assert done.returncode == code, done.stderr
    return done.stderr


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """A folder with ten good flights, and what was learnt from them."""
    folder = tmp_path_factory.mktemp("good")
    for seed in range(10):
        write(folder / f"good{seed}.pcapng", seed)
    learn(folder, *(f"good{seed}.pcapng" for seed in range(10)))
    return folder


def test_good_flights_keep_them(learnt, tmp_path):
    for seed in range(10):
        assert judge(learnt / f"good{seed}.pcapng", learnt / "flight.rules") == (0, [])
    for seed in range(100, 104):  # 100 and 103 have reserved values
        assert judge(write(tmp_path / "other.pcapng", seed), learnt / "flight.rules") == (0, []), seed


@pytest.mark.parametrize("deviation", DEVIATIONS)
def test_a_deviation_does_not(learnt, tmp_path, deviation):
    code, broken = judge(write(tmp_path / "bad.pcapng", 202, deviation), learnt / "flight.rules")
    assert code == 20
    assert any(DEVIATIONS[deviation] in rule for rule in broken), broken


def test_a_low_battery_shows_in_the_mean_of_a_short_flight(learnt, tmp_path):
    """Its lowest value is one that longer flights have, too."""
    code, broken = judge(write(tmp_path / "bad.pcapng", 205, "battery"), learnt / "flight.rules")
    assert code == 20
    assert {rule.partition("=")[0] for rule in broken} >= {f"{name} motor.dc_voltage.mean" for name in NAMES.values()}


def test_what_stands_in_the_file(learnt):
    """A controller has its own limits, and each says whose the extremes are."""
    text = (learnt / "flight.rules").read_text()
    assert all(f"\nsource={name}\n" in text for name in NAMES.values())
    assert "\nabsent=0\nunknown=0\n" in text
    low, high, lowest, at_low, highest, at_high = re.search(
        r"motor\.dc_voltage=(.*)\.\.(.*?) +# (.*) in (good\d\.pcapng), (.*) in (good\d\.pcapng)", text
    ).groups()
    assert float(low) < float(lowest) < float(highest) < float(high)
    export = ["tshark", "-q", "-r", learnt / at_low, "-X", f"lua_script:{PLUGIN}", *OPTIONS, "-z", "yapp,summary,json"]
    done = subprocess.run(export, capture_output=True, text=True, check=True)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert float(lowest) in {row["values"].get("dc_voltage", {}).get("min") for row in rows}
    assert at_high != at_low


def test_fields_with_the_names_of_measures(tmp_path, monkeypatch):
    """The rate of the messages is 10 Hz, the field of this name 1000 to 1009."""
    fields = ", ".join(f'{{ "{name}", "uint16", "{name.title()}" }}' for name in ("rate", "gap", "mean", "spread"))
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
    }
    expected = {"rate": (10, 10), "rate.value": (1000, 1009), "rate.mean": (1004.5, 1004.5), "mean": (0, 99)}
    for name, (lowest, highest) in expected.items():
        low, high = map(float, learnt[name])
        assert lowest - 30 < low <= lowest <= highest <= high < highest + 30, name


def test_an_enum_that_never_changed(learnt, tmp_path):
    """Motor Mode was 1 in all good flights; a flight in Torque Mode, 0, is not like them."""
    text = (learnt / "flight.rules").read_text()
    assert re.findall(r"(?m)^motor\.motor_mode=(.*?) +# (.*)$", text) == [("1..1", "Speed Mode")] * 4
    other = tmp_path / "flight.rules"
    other.write_text(text.replace("motor_mode=1..1", "motor_mode=0..0"))
    code, broken = judge(learnt / "good0.pcapng", other)
    assert (code, broken) == (20, [f"{name} motor.motor_mode=0..0" for name in NAMES.values()])


def test_ratios():
    """10 A beside 8, 7 and 2.5 A are 1.429 times their median; a mean near 0 gives no ratio."""
    numbers = {"a": (10, 12), "b": (8, 9), "c": (7, 9), "e": (2.5, 9)}
    values = {name: {"mean": mean, "max": top} for name, (mean, top) in numbers.items()}
    found = {name: round(ratio, 3) for name, ratio in baseline._ratios(values).items()}
    assert found == {"a": 1.429, "b": 1.143, "c": 0.875, "e": 0.312}
    for mean, top in ((0.9, 90), (-7, 12), (None, None)):
        assert baseline._ratios(values | {"d": {"mean": mean, "max": top}}) == {}, mean
    assert baseline._ratios({"a": values["a"]}) == {}


def test_without_names(learnt, tmp_path):
    """Rules are about all controllers then; a wider margin is wider."""
    options = OPTIONS[:4]
    learn(tmp_path, learnt / "good0.pcapng", learnt / "good1.pcapng", options=options)
    narrow = (tmp_path / "flight.rules").read_text()
    assert "source=" not in narrow
    assert "# absent=0: good1.pcapng does not keep it (no source is named" in narrow
    learn(tmp_path, learnt / "good0.pcapng", learnt / "good1.pcapng", "--margin", "50%", options=options)
    limits = [
        float(re.search(r"motor_temperature=.*\.\.(\S+)", text)[1])
        for text in (narrow, (tmp_path / "flight.rules").read_text())
    ]
    assert limits[0] < limits[1]


def test_what_happens_in_good_flights_may_happen(tmp_path):
    """This flight has faults, a reboot, lost messages and reserved values: as many, and a bit more, are good."""
    flights.write(tmp_path / "a.pcapng", 5, 60)
    learn(tmp_path, "a.pcapng", options=OPTIONS[:4])
    text = (tmp_path / "flight.rules").read_text()
    assert re.search(r"^motor\.rpm_measured=", text, re.MULTILINE)
    for rule in ("fault", "reboot", "silence", "incomplete"):
        (limit, seen) = re.search(rf"^{rule}=(\d+) +# (\d+) in a\.pcapng$", text, re.MULTILINE).groups()
        assert int(limit) >= int(seen) > 0
    share = re.search(r"^motor\.esc_temperature\.special=(\S+) +# (\S+) in a\.pcapng$", text, re.MULTILINE)
    assert float(share[1]) > float(share[2]) > 0
    assert judge(tmp_path / "a.pcapng", tmp_path / "flight.rules") == (0, [])


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


def test_a_margin_that_is_none(learnt):
    assert "10 is not a share such as 10%" in learn(learnt, "good0.pcapng", "--margin", "10", code=2)


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
    assert baseline.held(one, one.columns["x"], length, 0.1) == max(map(min, stretches))


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
        assert baseline._rule(one, one.found, (0.0, 0.0), 0.1).lost == lost


def test_what_aircraft_show_under_load(tmp_path):
    """One with a worn controller: a propeller that is lost, and noise, break rules that a good flight keeps.  Of six
    flights the limits over the speed are too narrow: they learn from ten."""
    names = [aircraft.write(tmp_path / f"good{seed}.pcapng", "worn", seed).name for seed in range(10)]
    learn(tmp_path, *names, options=aircraft.options("worn"))
    text = (tmp_path / "flight.rules").read_text()
    speed = [f"{name}.over(rpm_measured)=" for name in ("dc_current", "dc_power", "torque_iq_measured")]
    for rule in (*speed, "motor_temperature.over(dc_current)=", "rpm_error.noise="):
        assert re.search(rf"^motor\.{re.escape(rule)}.* # .* in good\d", text, re.M), rule
    for seed, defect, code in ((50, None, 0), (51, "propeller", 20), (52, "noise", 20)):
        path = aircraft.write(tmp_path / "flight.pcapng", "worn", seed, defect)
        found, broken = judge(path, tmp_path / "flight.rules", aircraft.options("worn"))
        assert found == code, (defect, broken)
    assert any(".noise=" in rule for rule in broken)


def trial(folder):
    """Judge held-out flights."""
    learn(folder, *(write(folder / f"good{seed}.pcapng", seed) for seed in range(10)))
    broken, found = Counter(), Counter()
    for seed in range(1000, 1020):
        code, rules = judge(write(folder / "clean.pcapng", seed), folder / "flight.rules")
        print("clean", seed, code, rules)
        broken[code] += 1
    for seed in range(2000, 2028):
        deviation = list(DEVIATIONS)[seed % len(DEVIATIONS)]
        code, rules = judge(write(folder / "bad.pcapng", seed, deviation), folder / "flight.rules")
        print(deviation, seed, code, rules)
        found[deviation, code] += 1
    print("clean:", dict(broken), "planted:", dict(found))


if __name__ == "__main__":
    trial(Path(sys.argv[1]))
