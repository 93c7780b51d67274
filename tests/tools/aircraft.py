# SPDX-License-Identifier: GPL-2.0-or-later
"""Flights of four kinds of aircraft with known truth: good ones, and with one planted defect.

Of a flight are its air, its load, its battery and its wind; of a controller its wear; of each flight and controller a
bit of chance. Speeds follow commands with a lag, currents are those of propellers and of acceleration; braking gives
some back.
"""

import math
import random
import struct

import flights

# motors; speed at hover, RPM; current at hover, A; battery, V; lag, s; noise of speed, RPM; kinds of wear by motor
KINDS = {
    "eight small": {"motors": 8, "speed": 6200, "current": 7, "battery": 25, "lag": 0.08, "noise": 12},
    "four large": {"motors": 4, "speed": 2600, "current": 42, "battery": 50, "lag": 0.25, "noise": 5},
    "coaxial": {"motors": 8, "speed": 3600, "current": 20, "battery": 50, "lag": 0.15, "noise": 8, "lower": 1.14},
    "worn": {"motors": 4, "speed": 3400, "current": 24, "battery": 48, "lag": 0.15, "noise": 8, "worn": 2},
}
DEFECTS = ("hot", "speed", "noise", "propeller", "phase", "bearing", "battery", "ignored", "regeneration")


def ids(kind, first=0x210):
    return [(number // 4, first + number % 4) for number in range(KINDS[kind]["motors"])]


def options(kind):
    """Options of tshark, with a name for each controller."""
    names = [f"can{bus}/{ident:#x}=motor:m{number}" for number, (bus, ident) in enumerate(ids(kind))]
    return ("-o", "yapp.motor_ids:0x210-0x213", "-o", f"yapp.sources:{','.join(names)}")


def write(path, kind, seed, defect=None):
    """Write a flight of about a minute; returns its path."""
    about, rng, pcap = KINDS[kind], random.Random(f"{kind} {seed}"), flights.Pcapng(path)
    air = {
        "length": rng.uniform(40, 70),
        "ambient": rng.gauss(18, 5),
        "density": rng.gauss(1, 0.02),
        "load": rng.gauss(1, 0.015),
        "battery": about["battery"] * rng.gauss(1, 0.003),
        "wind": rng.uniform(0.7, 1.3),
        "phases": [rng.uniform(0, 6) for _ in range(3)],
        "steps": [],
    }
    at = 6.0
    while at < air["length"] - 8:
        air["steps"].append((at, rng.uniform(0.8, 2.0), rng.choice([-1, 1]) * rng.uniform(0.06, 0.16)))
        at += rng.uniform(3, 7)
    bad = rng.randrange(about["motors"])
    packets = []
    for number, (bus, ident) in enumerate(ids(kind)):
        own = defect if number == bad or defect == "battery" else None
        packets += [(at, bus, ident, payload) for at, payload in _controller(about, air, number, own, f"{kind} {seed}")]
    for packet in sorted(packets):
        flights.send(pcap, *packet)
    pcap.file.close()
    return path


def _command(about, air, number, time):
    if time < 2 or time > air["length"] - 1:
        return 0.0
    share = min((time - 2) / 1.5, 1, (air["length"] - 1 - time) / 2)
    gust = air["wind"] * (0.03 * math.sin(time / 5 + air["phases"][0]) + 0.02 * math.sin(time / 1.7 + air["phases"][1]))
    own = 0.012 * math.sin(time / 4 + number + air["phases"][2])
    step = sum(size for at, length, size in air["steps"] if at <= time < at + length)
    return about["speed"] * math.sqrt(air["load"]) * share * (1 + gust + own + step)


def _controller(about, air, number, defect, seed):
    """Yield the time and the payload of each message."""
    wear = random.Random(f"wear {about['speed']} {number}")  # the same in each flight
    rng = random.Random(f"{seed} {number}")
    drag, warm = wear.gauss(1, 0.03), wear.gauss(0, 1)
    noise, sag = about["noise"], rng.gauss(0, 0.02)
    if number % 2 and "lower" in about:
        drag, warm = drag * about["lower"], warm + 6
    if number == about.get("worn"):
        drag, warm, noise = drag * 1.06, warm + 5, noise * 1.6
    drag *= rng.gauss(1, 0.006)
    half, time = air["length"] / 2, rng.uniform(0, 0.1)
    speed, heat, boot = 0.0, air["ambient"] + warm, rng.randrange(10**12)
    ignored = rng.choice(air["steps"])[0] + rng.uniform(-0.1, 0.1) if defect == "ignored" else math.inf
    while time < air["length"]:
        command = _command(about, air, number, time)
        before = speed
        if not 0 <= time - ignored < 0.6:
            speed += (command - speed) * (1 - math.exp(-0.1 / about["lag"]))
        is_late = time > half
        shaking = 5 if defect == "noise" else 3 if defect == "phase" and is_late else 1
        measured = max(speed + rng.gauss(0, noise * shaking) * (speed > 0), 0)
        share = speed / about["speed"]
        voltage = air["battery"] - time * 0.001 * about["battery"]
        load = drag * air["density"] * share**3 * {"bearing": 1.08}.get(defect, 1)
        if is_late and defect == "propeller":
            load *= 0.6
        if is_late and defect == "phase":
            load *= 0.75 + rng.gauss(0, 0.15)
        push = max(min(12 * (speed - before) / about["speed"], 1), -1)  # of acceleration
        current = about["current"] * (0.04 + load + push * share) * about["battery"] / voltage
        if defect == "regeneration":
            current = max(current, 0)
        current += rng.gauss(0, 0.01 * about["current"])
        torque = about["current"] * (load / max(share, 0.2) + push) + rng.gauss(0, 0.02 * about["current"])
        voltage -= current * 0.0015 * about["battery"] / about["current"] + rng.gauss(0, 0.02) - sag
        voltage -= 4 if defect == "battery" else 0
        heat += (air["ambient"] + warm + 22 * load * drag - heat) * 0.1 / 20
        motor = heat + 3 + (10 * (1 - math.exp(-max(time - half, 0) / 3)) if defect == "hot" else 0)
        shown = measured * (1.04 if defect == "speed" else 1)
        at = int(time * 1e9)
        yield flights.START + at, _payload(command, shown, current, torque, voltage, motor, heat, boot + at)
        time += 0.1 + rng.uniform(-0.003, 0.003)


def _payload(command, speed, current, torque, voltage, motor, esc, clock):
    wide = [flights.count(one, -128, 128, 65530) for one in (torque, torque, voltage, current)]
    rates = [flights.count(one, -60000, 60000, 65530) for one in (command, speed)]
    warm = [flights.count(one, -40, 210, 250) for one in (motor, esc)]
    status = 0x12_0000 if command else 0x1_0000
    return struct.pack("<6HBBIIqBB", *wide[:2], *rates, *wide[2:], warm[0], 1, status, 0, clock,
                       2 if command else 4, warm[1])  # fmt: skip
