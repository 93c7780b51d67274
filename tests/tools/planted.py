# SPDX-License-Identifier: GPL-2.0-or-later
"""Flights of eight controllers on two buses with planted incidents: from the ground to the ground, with wind.

planted.py SEED SECONDS FILE.pcapng KIND...       writes a flight with these incidents, "all" for all of KINDS
planted.py innocents FIRST LAST                   counts whom the page accuses in flights of these seeds wrongly
"""

import html
import math
import random
import re
import struct
import sys
import tempfile
from pathlib import Path

import flights
from running import PLUGIN, run_tables

NAMES = [f"{end}{number}" for end in "FR" for number in range(1, 5)]
ENDS = ("front", "rear")
SOURCES = ",".join(
    [f"can{n // 4}/{0x210 + n % 4:#x}+{0x200 + n % 4:#x}={name}" for n, name in enumerate(NAMES)]
    + [f"can{n}/0x0={end}" for n, end in enumerate(ENDS)]
)
OPTIONS = ("-o", "yapp.motor_ids:0x210-0x213", "-o", "yapp.health_ids:0x200-0x203", "-o", f"yapp.sources:{SOURCES}")
# Of one controller; of all on a bus; of the aircraft.
OF_ONE, OF_BUS, OF_ALL = ("overcurrent", "hot", "load", "silent", "reboot"), ("lost", "disabled"), ("sag",)
KINDS = OF_ONE + OF_BUS + OF_ALL
# What the line of the guilty one says.
WORDS = {
    "overcurrent": r"Motor overcurrent at .*, (2\.[2-9]|3\.[01]) times the others', from 0\.[3-7]\d\d s before",
    "hot": r"Motor Temperature \d+ °C at the end, \d+ above the others",
    "load": r"(2[89]|3\d)% more current throughout",
    "silent": r"silent \d+\.\d{3} s",
    "reboot": r"rebooted at .*, silent 1\.\d{3} s",
    "lost": r"Commands lost [01]\.\d{3} s",
    "disabled": r"Command disabled 0\.\d{3} s at .*; [FR]1 to [FR]4 slowed",
    "sag": r"\d+\.\d to \d+\.\d V, .*, all controllers",
}
TICK = 0.02
SPEED, AMPERES, DEGREES = (-60000, 60000, 65530), (-128, 128, 65530), (-40, 210, 250)
COMMANDED = (-100000, 100000, 65530)


class Flight:
    """What is planted: truth is {kind: (name, begin, end)}, in seconds from the first packet."""

    def __init__(self, seed, seconds, kinds):
        self.rng, self.seconds = random.Random(f"planted {seed} {seconds}"), seconds
        rng = self.rng
        # Each at a time of its own, in flight; no controller has two.
        slots = [(at + rng.uniform(0.2, 0.5)) / 8 * 0.74 + 0.14 for at in range(8)]
        rng.shuffle(slots)
        who = rng.sample(range(8), len(OF_ONE))
        self.truth = {}
        for kind, slot, number in zip(KINDS, slots, [*who, 0, 0, 0], strict=True):
            begin = slot * seconds
            length = {"overcurrent": 0.3, "reboot": 1.5, "lost": 0.9, "disabled": 0.45, "silent": seconds / 30,
                      "sag": seconds / 48}.get(kind, math.inf)  # fmt: skip
            name = NAMES[number] if kind in OF_ONE else ENDS[rng.randrange(2)] if kind in OF_BUS else "battery"
            begin = {"hot": 0.3 * seconds, "load": 0.0}.get(kind, begin)
            if kind in kinds:
                self.truth[kind] = (name, begin, begin + length)
        self.climbs = [(rng.uniform(0.1, 0.85) * seconds, rng.uniform(5, 15)) for _ in range(4)]
        self.waves = [(rng.uniform(40, 130), rng.uniform(3, 30), rng.uniform(0, 6)) for _ in range(3)]
        self.trim = rng.choice((1.0, 1.0, rng.uniform(0.92, 1.08)))  # of the rear: a load that lies far back
        self.ambient, self.battery, self.gust = rng.gauss(16, 6), rng.gauss(49.5, 0.5), 0.0

    def holds(self, kind, name, time, before=0.0):
        """Return whether an incident of this one is under way, or begins in so many seconds."""
        who, begin, end = self.truth.get(kind, ("", math.inf, 0.0))
        return who == name and begin - before <= time < end

    def command(self, time, end):
        """Return the speed that a bus is told, and whether it is enabled."""
        up, down = 0.03 * self.seconds, 0.965 * self.seconds
        share = min(1.0, max(0.0, (time - up) / 8)) * min(1.0, max(0.0, (down - time) / 6))
        speed = 3300 + sum(size * math.sin(time / length + phase) for size, length, phase in self.waves)
        speed += sum(500 for begin, length in self.climbs if begin <= time < begin + length)
        speed *= share * (self.trim if end else 1.0)
        is_enabled = up - 2 <= time < down + 3 and not self.holds("disabled", ENDS[end], time)
        return speed, is_enabled


class Motor:
    def __init__(self, flight, number):
        self.flight, self.rng, self.number, self.name = flight, flight.rng, number, NAMES[number]
        self.speed = self.heat = self.torque = 0.0
        self.own, self.cool = self.rng.gauss(1, 0.012), self.rng.gauss(1, 0.03)
        self.next, self.health, self.boot = self.rng.uniform(0, 0.1), self.rng.uniform(0, 0.5), -self.rng.uniform(5, 9)

    def run(self, time, command, is_enabled, wind, volts):
        flight, rng, name = self.flight, self.rng, self.name
        told, holds = command if is_enabled else 0.0, flight.holds
        # Without torque a propeller runs down slowly.
        self.speed += (told - self.speed) * (1 - math.exp(-TICK / (0.15 if is_enabled else 0.8)))
        push = max(0.0, (told - self.speed) / 100) if is_enabled else 0.0
        load = (0.2 + (self.speed / 3300) ** 3 * 19.3) * wind * self.own * is_enabled + min(push, 25)
        load *= 1.31 if holds("load", name, time) else 1
        self.heat += (load * 1.7 * self.cool - self.heat) * TICK / (self.flight.seconds / 3)
        if holds("silent", name, time) or holds("reboot", name, time):
            self.boot = time + 0.01 if holds("reboot", name, time) else self.boot
            self.next, self.health = max(self.next, time), max(self.health, time)
            return
        if time < self.next:
            return
        self.next += 0.1
        is_surge = holds("overcurrent", name, time, before=0.5)
        amperes = load * (2.5 if is_surge else 1) + rng.gauss(0, 0.12)
        begin = flight.truth.get("hot", ("", math.inf))[1]
        more = max(0.0, (time - begin) * 62 / flight.seconds / 0.7) if holds("hot", name, time) else 0.0
        hot = flight.ambient + 6 + self.heat + more + rng.gauss(0, 0.3)
        faults = flights.OVERCURRENT if holds("overcurrent", name, time) else 0
        clock = int((time - self.boot) * 1e9)
        speed = self.speed * (0.9 if is_surge else 1) + rng.gauss(0, 6) * (self.speed > 50)
        torque = flights.count(amperes * 1.35, *AMPERES)
        payload = struct.pack(
            "<6HBBIIqBB", torque, torque, flights.count(told, *SPEED), flights.count(speed, *SPEED),
            flights.count(volts - amperes * 0.03, *AMPERES), flights.count(amperes, *AMPERES),
            flights.count(hot, *DEGREES), 1, 0x12_0000 if is_enabled else 0x1_0000, faults, clock,
            0x20 if faults else 2, flights.count(flight.ambient + 8 + self.heat * 0.6 + more / 4, *DEGREES),
        )  # fmt: skip
        yield time + 0.004 + rng.uniform(0, 0.003), self.number // 4, 0x210 + self.number % 4, payload
        if time >= self.health:
            self.health += 0.5
            fet = round(flight.ambient + 12 + self.heat * 0.8 + 40)
            board = struct.pack("<q9B", clock, 40 + rng.randrange(3), 50, 80, fet, fet - 3, fet + 2, 9, 1, 2)
            yield time + 0.03, self.number // 4, 0x200 + self.number % 4, board


def write(path, seed, seconds, kinds=KINDS):
    """Write a flight. Returns the truth."""
    flight, packets = Flight(seed, seconds, kinds), []
    rng, motors = flight.rng, [Motor(flight, number) for number in range(8)]
    for tick in range(int(seconds / TICK)):
        time = tick * TICK
        flight.gust += -flight.gust * TICK / 4 + rng.gauss(0, 0.02) * math.sqrt(2 * TICK / 4)
        volts = flight.battery - 5 * time / seconds - (7 if flight.holds("sag", "battery", time) else 0)
        told = [flight.command(time, end) for end in (0, 1)]
        for end, (speed, is_enabled) in enumerate(told if tick % 5 == 0 else ()):
            if not flight.holds("lost", ENDS[end], time):
                command = struct.pack("<BBBHH", is_enabled, 0xA5, 1, 32765, flights.count(speed, *COMMANDED))
                packets.append((time, end, 0, command))
        for motor in motors:
            packets += motor.run(time, *told[motor.number // 4], 1 + flight.gust, volts)
    pcap = flights.Pcapng(path)
    for time, bus, message, payload in sorted(packets):
        lose = 2 if len(payload) > 8 and rng.random() < 0.0002 else None
        flights.send(pcap, flights.START + int(time * 1e9), bus, message, payload, lose=lose)
    pcap.file.close()
    return flight.truth


def causes(page):
    """Return {who: line below the verdict} of a page."""
    lines = re.findall(r"<li><b>(.*?)</b>: (.*?)</li>", re.search(r"<ul id=.causes.>(.*?)</ul>", page, re.S)[1])
    return {html.unescape(who).split(" ")[0]: html.unescape(re.sub("<.*?>", "", text)) for who, text in lines}


def judge(folder, seed, seconds, kinds):
    """Write a flight and its page. Returns the truth, and the lines below the verdict."""
    truth = write(folder / "flight.pcapng", seed, seconds, kinds)
    run_tables(folder, "report", "flight.pcapng", "--out", "page.html", "--plugin", PLUGIN, *OPTIONS, code=0)
    return truth, causes((folder / "page.html").read_text())


def innocents(first, last):
    """Judge flights with some incidents each: print who is accused wrongly, and what is not found."""
    accused = missed = planted = 0
    for seed in range(first, last):
        rng = random.Random(f"kinds {seed}")
        kinds = [kind for kind in KINDS if rng.random() < 0.6]
        with tempfile.TemporaryDirectory() as folder:
            truth, lines = judge(Path(folder), seed, 150.0, kinds)
        guilty = {"Battery" if name == "battery" else name for name, *_ in truth.values()}
        wrong = {who: text for who, text in lines.items() if who not in guilty}
        said = {kind: lines.get("Battery" if name == "battery" else name, "") for kind, (name, *_) in truth.items()}
        lost = {kind: text for kind, text in said.items() if not re.search(WORDS[kind], text)}
        accused, missed, planted = accused + len(wrong), missed + len(lost), planted + len(truth)
        print(seed, sorted(truth), "accused:", wrong, "missed:", lost, flush=True)
    print(f"{last - first} flights, {accused} innocents accused, {missed} of {planted} incidents missed")


if __name__ == "__main__":
    if sys.argv[1] == "innocents":
        innocents(int(sys.argv[2]), int(sys.argv[3]))
        sys.exit()
    kinds = KINDS if sys.argv[4:] == ["all"] else sys.argv[4:]
    print(write(sys.argv[3], int(sys.argv[1]), float(sys.argv[2]), kinds))
