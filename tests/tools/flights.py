# SPDX-License-Identifier: GPL-2.0-or-later
"""Flights with known truth: controllers on two buses; faults, a reboot, a silence, lost frames, reserved counts."""

from __future__ import annotations

import math
import random
import struct
import sys
from dataclasses import dataclass, field
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "e2e"))
import capture_file
from can_generator import SINGLE, Sent

START = 1_700_000_000_000_000_000  # nanoseconds since 1970
OPTIONS = ("yapp.motor_ids:0x210,0x211", "yapp.health_ids:0x200,0x201")
BUSES = ("can0", "can1")
OVERCURRENT, STALL = 0x1_0000, 0x80_0000
# Of eight controllers one has an overcurrent of 0.3 s, one falls silent for good, one gets hot.
EIGHT = ((), (), ("silent",), (), (), ("overcurrent",), (), ("hot",))
SHORT = 300_000_000  # nanoseconds of an overcurrent, and of the current before it
FLAGS = {OVERCURRENT: "motor_overcurrent", STALL: "motor_stall"}
NAN16, NAN8, ABOVE8 = 65535, 255, 252


def count(value, low, high, top):
    """The count that stands for a value: of 2^N - 6 equal steps the nearest."""
    return round((value - low) / (high - low) * top)


def value(raw, low, high, top):
    return low + raw * (high - low) / top


@dataclass
class Truth:
    """begin: the first packet; motor: (time, bus, id, raw speed, raw ESC temperature, faults);
    faults: (begin, end or None, bus, id, flag); reboots, incomplete: (time, bus, id);
    silences: (time, bus, id, length).  Times in nanoseconds."""

    begin: int = 0
    motor: list = field(default_factory=list)
    health: int = 0
    command: int = 0
    faults: list = field(default_factory=list)
    reboots: list = field(default_factory=list)
    silences: list = field(default_factory=list)
    incomplete: list = field(default_factory=list)


class Pcapng:
    def __init__(self, path):
        self.begin = None
        self.file = open(path, "wb")  # noqa: SIM115
        rows = [capture_file.interface(capture_file.SOCKETCAN, bus, capture_file.NANOSECONDS) for bus in BUSES]
        self.file.write(capture_file.section(*rows))

    def frame(self, time, bus, frame):
        self.begin = self.begin or time
        self.file.write(capture_file.packet(time, frame.record(), bus))


class Controller:
    """One controller and what happens to it."""

    def __init__(self, rng, seconds, number, of_a_bus, plan):
        self.rng, self.number = rng, number
        self.bus, self.on_bus = divmod(number, of_a_bus)
        self.boot = START - rng.randrange(10**10)
        self.fault = self.reboot = self.silence = None
        at = START + int(seconds * 1e9 * rng.uniform(0.2, 0.4))
        if "fault" in plan:
            self.fault = at, at + int(seconds * 1e9 * 0.1), OVERCURRENT
        if "last fault" in plan:
            self.fault = at, None, STALL
        if "reboot" in plan:
            self.reboot = at
        if "silence" in plan:
            self.silence = at, at + int(seconds * 1e9 * 0.1)
        if "silent" in plan:
            self.silence = at, math.inf
        if "overcurrent" in plan:
            self.fault = at, at + SHORT, OVERCURRENT
        self.surge = (at - SHORT, at + SHORT) if "overcurrent" in plan else (math.inf, 0)
        self.hot = at if "hot" in plan else math.inf

    def motor(self, time):
        phase = (time - START) / 1e9
        heat = max(0, min((time - self.hot) / 1e9 / 4, 60))
        command = 4000 + 500 * math.sin(phase / 7) + 40 * math.sin(phase / 3 + self.number)
        speed = command + self.rng.gauss(0, 5)
        raw_speed = NAN16 if self.rng.random() < 0.002 else count(speed, -60000, 60000, 65530)
        raw_temperature = (
            self.rng.choice([NAN8, ABOVE8]) if self.number == 3 and phase % 20 < 1 else count(45 + heat, -40, 210, 250)
        )
        begin, end, flag = self.fault or (math.inf, None, 0)
        faults = flag if begin <= time < (end or math.inf) else 0
        surge = 2.6 if self.surge[0] <= time < self.surge[1] else 1
        amperes = (12 * (speed / 4000) ** 2 + self.rng.gauss(0, 0.3)) * surge
        current, voltage = (count(one, -128, 128, 65530) for one in (amperes, 50 - 0.15 * amperes))
        payload = struct.pack(
            "<6HBBIIqBB", current, current, count(command, -60000, 60000, 65530), raw_speed, voltage,
            current, count(50 + min(phase / 60, 100) + heat, -40, 210, 250), 1, 0x0012_0000, faults, time - self.boot,
            0x20 if faults else 0x2, raw_temperature,
        )  # fmt: skip
        return payload, raw_speed, raw_temperature, faults

    def health(self, time):
        return struct.pack("<q9B", time - self.boot, 40, 50, 80, 85, 90, 3, 9, 1, 2)


def write(path, seed, seconds, plans=(("fault",), ("reboot",), ("silence",), ("last fault",))):
    """Write a flight; plans: what happens to each controller. Returns its Truth."""
    rng, truth, pcap = random.Random(seed), Truth(), Pcapng(path)
    of_a_bus = max(2, len(plans) // len(BUSES))
    controllers = [Controller(rng, seconds, n, of_a_bus, plan) for n, plan in enumerate(plans)]
    state = [{"faults": 0, "last": None, "since": None} for _ in plans]
    for tick in range(int(seconds * 10)):
        for n, controller in enumerate(controllers):
            time = START + tick * 100_000_000 + n * 7_000_000 + rng.randrange(1_000_000)
            if controller.on_bus == 0:
                truth.command += 1
                send(pcap, time - 1_000_000, controller.bus, 0, struct.pack("<BBBHH", 1, 0xA5, 1, 32765, 34000))
            if controller.silence and controller.silence[0] <= time < controller.silence[1]:
                continue
            _motor(pcap, truth, controller, state[n], time)
            if tick % 5 == 0:
                truth.health += 1
                send(pcap, time + 3_000_000, controller.bus, 0x200 + controller.on_bus, controller.health(time))
    for one, known in zip(controllers, state, strict=True):
        if known["faults"]:
            truth.faults.append((known["since"], None, BUSES[one.bus], 0x210 + one.on_bus, FLAGS[known["faults"]]))
    truth.begin = pcap.begin
    truth.faults.sort(key=lambda row: row[0])
    pcap.file.close()
    return truth


def _motor(pcap, truth, controller, known, time):
    """Send Motor Data, or lose a frame of it, and note what that means."""
    bus, message = BUSES[controller.bus], 0x210 + controller.on_bus
    if controller.reboot and time >= controller.reboot:
        controller.boot, controller.reboot, rebooted = time - 10_000_000, None, True
    else:
        rebooted = False
    payload, raw_speed, raw_temperature, faults = controller.motor(time)
    lose = not rebooted and known["faults"] == faults and controller.rng.random() < 0.004
    send(pcap, time, controller.bus, message, payload, lose=2 if lose else None)
    if lose:
        truth.incomplete.append((time, bus, message))
        return
    done = time + 4 * 100_000
    if rebooted:
        truth.reboots.append((done, bus, message))
    if known["last"] and done - known["last"] > 250_000_000:
        truth.silences.append((known["last"], bus, message, done - known["last"]))
    if faults and not known["faults"]:
        known["since"] = done
    if known["faults"] and not faults:
        truth.faults.append((known["since"], done, bus, message, FLAGS[known["faults"]]))
    known["faults"], known["last"] = faults, done
    truth.motor.append((done, bus, message, raw_speed, raw_temperature, faults))


def send(pcap, time, bus, message, payload, lose=None):
    sent = Sent(message, 0, 0, payload)
    frames = sent.frames() if len(payload) > 8 else [sent.frame(SINGLE, payload)]
    for number, frame in enumerate(frames):
        if number != lose:
            pcap.frame(time + number * 100_000, bus, frame)
