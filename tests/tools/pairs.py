# SPDX-License-Identifier: GPL-2.0-or-later
"""Pairs of runs with known truth: equal but for seed and weather, or with one planted change.

pairs.py FIRST LAST judges these pairs: an even number is an equal pair, an odd one has a planted change.
pairs.py BEFORE.pcapng AFTER.pcapng writes two runs: in the second, one controller takes 3 % more current.
"""

import json
import math
import random
import struct
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import flights
from running import PLUGIN, run_tables

NAMES = {("can0", 0x210): "fl", ("can0", 0x211): "fr", ("can1", 0x210): "rl", ("can1", 0x211): "rr"}
SOURCES = ",".join(
    f"{bus}/{ident:#x}=motor:{name},{bus}/{ident - 16:#x}=health:{name}" for (bus, ident), name in NAMES.items()
)
OPTIONS = ("-o", "yapp.motor_ids:0x210,0x211", "-o", "yapp.health_ids:0x200,0x201", "-o", f"yapp.sources:{SOURCES}")
# What is planted, by how much, and which words of a finding name it. The size of jitter is beyond its multiple of 1.
PLANTED = {
    "current": (0.03, "DC Current"), "temperature": (4.0, "Motor Temperature"), "jitter": (1.0, "jitter of Motor Data"),
    "cpu": (10.0, "CPU"), "size": (2, "size of Motor Data"), "flag": (0.014, "motor_overcurrent"),
    "lag": (40.0, "response"),
}  # fmt: skip
SECONDS, TICK = 100.0, 0.02
SPEED, AMPERES, DEGREES = (-60000, 60000, 65530), (-128, 128, 65530), (-40, 210, 250)


class Weather:
    """Wind, battery, temperature and the order of manoeuvres of a run."""

    def __init__(self, rng, seconds=SECONDS):
        self.seconds = seconds
        self.ambient, self.battery = rng.gauss(18, 3), rng.gauss(50.2, 0.3)
        self.steady, self.gust, self.rng = rng.gauss(0, 0.004), 0.0, rng
        holds = [("hold", speed) for speed in (2800, 3200, 3700, 4200)]
        waves = [("wave", speed) for speed in (3200, 3600, 3900)]
        self.manoeuvres = [*holds, *waves, ("steps", 3500), ("steps", 4000), ("climb", 3000)]
        rng.shuffle(self.manoeuvres)
        self.phases = [rng.uniform(0, 6) for _ in range(10)]

    def command(self, time):
        if time < 4:
            return 900.0 * time
        part = self.seconds / len(self.manoeuvres)
        number = min(int(time / part), len(self.manoeuvres) - 1)
        (kind, base), phase = self.manoeuvres[number], self.phases[number]
        match kind:
            case "wave":
                return base + 300 * math.sin(time / 1.5 + phase)
            case "steps":
                return base + 400 * (int((time + phase) / 2.5) % 2)
            case "climb":
                return base + 1000 * (time - number * part) / part
        return base + 15 * math.sin(time * 2 + phase)

    def blow(self):
        """A gust that lasts about 6 s."""
        self.gust += -self.gust * TICK / 6 + self.rng.gauss(0, 0.02) * math.sqrt(2 * TICK / 6)
        return 1 + self.steady + self.gust


def write(path, seed, changes=(), seconds=SECONDS, begin=0.0):
    """Write a run; changes: {number of the controller: {kind: amount}}; begin: seconds after flights.START."""
    rng, pcap, changes = random.Random(f"run {seed}"), flights.Pcapng(path), dict(changes)
    weather, packets = Weather(rng, seconds), []
    motors = [Motor(rng, number, changes.get(number, {})) for number in range(len(NAMES))]
    past, command = [0.0] * 30, 0.0
    for tick in range(int(seconds / TICK)):
        time, wind = tick * TICK, weather.blow()
        if tick % 5 == 0:  # a controller has the command from the message on
            command = weather.command(time)
            told = struct.pack("<BBBHH", 1, 0xA5, 1, 32765, flights.count(command, -100000, 100000, 65530))
            packets += [(time, bus, 0, told) for bus in (0, 1)]
        past = [command, *past[:29]]
        for motor in motors:
            packets += motor.run(time, past, command, wind, weather)
    packets.sort()
    for time, bus, message, payload in packets:
        lose = 2 if len(payload) > 8 and rng.random() < 0.002 else None
        flights.send(pcap, flights.START + int((begin + time) * 1e9), bus, message, payload, lose=lose)
    pcap.file.close()
    return path


class Motor:
    """A controller: speed, heat and processor follow command and wind."""

    def __init__(self, rng, number, changes):
        self.rng, self.number, self.changes = rng, number, changes
        self.speed = self.heat = self.health = self.cpu = 0.0
        self.next, self.fault = rng.uniform(0, 0.1), -1.0

    def run(self, time, past, command, wind, weather):
        rng, more = self.rng, self.changes.get
        late = (0.04 + more("lag", 0) / 1e3) / TICK  # ticks
        told = past[int(late)] + (late - int(late)) * (past[int(late) + 1] - past[int(late)])
        self.speed += (told - self.speed) * (1 - math.exp(-TICK / 0.12))
        load = (0.5 + (self.speed / 4000) ** 2 * 12 * (0.98 + 0.013 * self.number)) * wind
        self.heat += (load * 2.2 - self.heat) * TICK / 40
        if time < self.next:
            return
        self.next += 0.1
        amperes = load * (1 + more("current", 0)) + rng.gauss(0, 0.1)
        hot = weather.ambient + 5 + self.heat + more("temperature", 0) + rng.gauss(0, 0.3)
        if rng.random() < 0.002 + more("flag", 0):
            self.fault = time + 0.05
        faults, clock = flights.OVERCURRENT if time <= self.fault else 0, int((time + 1000) * 1e9)
        current, volts = flights.count(amperes, *AMPERES), weather.battery - time * 0.012 - amperes * 0.05
        payload = struct.pack(
            "<6HBBIIqBB", flights.count(amperes * 1.2, *AMPERES), flights.count(amperes * 1.2, *AMPERES),
            flights.count(command, *SPEED), flights.count(self.speed + rng.gauss(0, 8), *SPEED),
            flights.count(volts, *AMPERES), current, flights.count(hot, *DEGREES), 1, 0x12_0000, faults, clock,
            0x20 if faults else 2,
            flights.count(weather.ambient + 3 + self.heat * 0.7 + rng.gauss(0, 0.3), *DEGREES),
        )  # fmt: skip
        at = time + 0.01 + rng.gauss(0, 0.002 * (1 + more("jitter", 0)))
        yield at, self.number // 2, 0x210 + self.number % 2, payload + bytes(more("size", 0))
        if time >= self.health:
            self.health += 0.5
            self.cpu += (rng.gauss(0, 4) - self.cpu) * 0.3
            counts = round(40 + self.cpu + more("cpu", 0) / 0.4)  # 0.4 % a count
            board = struct.pack("<q9B", clock, counts, 50, 80, 85, 90, 3, 9, 1, 2)
            yield time + 0.03, self.number // 2, 0x200 + self.number % 2, board


def judge(folder, number, *more):
    """Write a pair and compare it. Returns what was planted, of whom, the exit code and the findings."""
    planted = list(PLANTED)[number // 2 % len(PLANTED)] if number % 2 else None
    who = number // 2 % 4
    write(folder / "before.pcapng", f"{number} before")
    write(folder / "after.pcapng", f"{number} after", {who: {planted: PLANTED[planted][0]}} if planted else {})
    done = run_tables(folder, "diff", "before.pcapng", "after.pcapng", "--json", "--plugin", PLUGIN, *OPTIONS, *more)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert rows, done.stderr
    return planted, list(NAMES.values())[who], done.returncode, rows[:-1]


def is_found(planted, who, findings):
    """Whether a finding names what was planted, of whom, and its size within 20 %."""
    size, word = PLANTED[planted]
    own = [one for one in findings if one["controller"] == who and word in one["measure"]]
    return any(planted == "flag" or abs(one["change"] / size - 1) <= 0.2 for one in own if one["kind"] != "better")


def trial(number):
    with tempfile.TemporaryDirectory() as folder:
        planted, who, code, findings = judge(Path(folder), number)
    texts = [f"{one['kind']} {one['controller']}: {one['text']}" for one in findings]
    worse = sum(one["kind"] == "worse" for one in findings)
    return number, planted, who, code, is_found(planted, who, findings) if planted else worse, texts


if __name__ == "__main__":
    if sys.argv[1].endswith(".pcapng"):
        write(sys.argv[1], "before"), write(sys.argv[2], "after", {0: {"current": 0.03}})
        sys.exit()
    numbers = range(int(sys.argv[1]), int(sys.argv[2]))
    found = worse = 0
    with ProcessPoolExecutor(2) as pool:
        for number, planted, who, code, result, texts in pool.map(trial, numbers):
            print(number, planted, who, code, result, *texts, sep="\n  ", flush=True)
            found += bool(result) if planted else 0
            worse += 0 if planted else result
    print(f"{sum(number % 2 for number in numbers)} planted, {found} found; false: {worse} worse")
