#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes two flights of two controllers, one on each bus.  Both motors run up to 5200 RPM.

docs/first.pcapng, of README.md, has a single fault: something brakes the motor on can1, its controller says overcurrent and
stops, and runs up once more when the fault is cleared.  In docs/flight.pcapng, of docs/fault.md, the controller is silent after
that, as it starts anew."""
import dataclasses
import struct

import make

FULL = 5200  # RPM
FAILED = "can1"


@dataclasses.dataclass(frozen=True)
class Plan:
    """When what happens to the motor that fails, in seconds."""

    name: str
    seconds: int
    jam: float
    fault: float
    cleared: float
    again: float
    boot: float = float("inf")
    idle_key: int = 0  # of a Command that switches the motor off

    @property
    def target(self):
        return make.FOLDER.parent / "docs" / f"{self.name}.pcapng"


PLANS = [Plan("first", 6, jam=2.7, fault=3.0, cleared=4.2, again=4.7, idle_key=0xA5),
         Plan("flight", 12, jam=5.2, fault=5.6, cleared=7.1, again=9.0, boot=7.9)]
OVERCURRENT = 0x10000
RUNNING, STOPPED = 0x40120000, 0x40010000  # status flags: closed loop and enabled, stopped
STATES = {"running": 0x03, "ready": 0x05, "faulted": 0x24}


def count(value, low, high):
    """A compressed float of 16 bits."""
    return round((value - low) / (high - low) * 65530).to_bytes(2, "little")


class Motor:
    """A controller and its motor, a tick of 100 ms after the other."""

    def __init__(self, bus, plan):
        self.bus, self.plan, self.rpm, self.boot = bus, plan, 0.0, -3600.0

    def asked(self, now):
        """The speed that is commanded; None where the motor is switched off."""
        if self.bus == FAILED and self.plan.cleared - 0.5 <= now < self.plan.again:
            return None
        begin = self.plan.again if self.bus == FAILED and now >= self.plan.again else 0.5
        return max(0.0, min(FULL, (now - begin) * 2200))

    def command(self, now):
        asked = self.asked(now)
        key = [0, self.plan.idle_key, 1] if asked is None else [1, 0xA5, 1]
        return bytes(key) + count(0, -200, 200) + count(asked or 0, -1e5, 1e5)

    def motor(self, now):
        plan, failed = self.plan, self.bus == FAILED
        jammed, faulted = failed and plan.jam <= now < plan.fault, failed and plan.fault <= now < plan.cleared
        asked = 0 if faulted else self.asked(now)
        wobble = (round(now * 10) * 7919 % 13 - 6) / 6
        if asked:
            self.rpm += (asked * (1 - 1.1 * (now - plan.jam) * jammed) - self.rpm) * 0.8
        else:
            self.rpm *= 0.86
        amps = (3 + (asked / 1500) ** 2 * 1.6 + (now - plan.jam + 0.1) * 110 * jammed + 0.3 * wobble) if asked else 0
        state = "faulted" if faulted else "running" if asked else "ready"
        values = count(amps, -128, 128) + count(amps + 0.1 * wobble, -128, 128)
        values += count(asked or 0, -60000, 60000) + count(self.rpm + 9 * wobble * bool(asked), -60000, 60000)
        values += count(48.4 - amps / 25, -128, 128) + count(amps * 0.8, -128, 128)
        warm = int(now * 1.5) + 12 * (failed and now >= plan.jam)
        return (values + bytes([70 + warm, 1]) + struct.pack("<II", RUNNING if asked else STOPPED, OVERCURRENT * faulted)
                + self.clock(now) + bytes([STATES[state], 75 + warm]))

    def health(self, now):
        return self.clock(now) + bytes([60, 30, 90 + int(now), 80, 85 + int(now), 4, 9, 0, 3])

    def clock(self, now):
        if self.bus == FAILED and now >= self.plan.boot and self.boot < 0:
            self.boot = self.plan.boot - 0.35
        return struct.pack("<q", round((now - self.boot) * 1e9))

    def is_silent(self, now):
        """While it starts."""
        return self.bus == FAILED and self.plan.cleared + 0.25 < now < self.plan.boot < self.plan.seconds


def lines(plan):
    """A flight as a text for make.py."""
    yield "format pcapng"
    motors = [Motor("can0", plan), Motor("can1", plan)]
    for tick in range(plan.seconds * 10):
        now = tick / 10
        for place, motor in enumerate(motors):
            at = now + place * 0.013
            if not motor.is_silent(now):
                yield f"{at:.4f} {motor.bus} [210 {motor.motor(now).hex(' ')}]"
            if tick % 2 == 0:
                yield f"{at + 0.004:.4f} {motor.bus} [0 {motor.command(now).hex(' ')}]"
            if tick % 5 == 1 and not motor.is_silent(now):
                yield f"{at + 0.006:.4f} {motor.bus} [200 {motor.health(now).hex(' ')}]"


def flight(plan):
    """The bytes of the capture."""
    return make.pcapng(make.Source("\n".join(lines(plan))))


if __name__ == "__main__":
    for each in PLANS:
        each.target.write_bytes(flight(each))
