# SPDX-License-Identifier: GPL-2.0-or-later
"""-z yapp,fault: the card of a fault.  Random flights with a planted cause before each fault: what departed first, and by how much."""
import dataclasses
import json
import random

import pytest

import flights
import levels
import model
import tshark
from can_generator import SINGLE, Sent

SECOND = flights.SECOND
PERIOD = {"command": SECOND // 20, "motor": SECOND // 10, "health": SECOND // 2}
ID = {"command": 0x000, "motor": 0x210, "health": 0x200}
BUSES = ["can0", "can1"]
FAULT_AT = [15, 35, 55, 75]  # seconds; each has ten seconds of its own before it
LENGTH = 80
# What is usual: value and noise (standard deviation) in the unit.  A departure is a multiple of that noise, and of the step.
USUAL = {
    "torque_iq_commanded": (23, 0.2), "torque_iq_measured": (23, 0.2), "rpm_commanded": (3300, 0), "rpm_measured": (3300, 8),
    "dc_voltage": (45, 0.05), "dc_current": (19, 0.2), "motor_temperature": (34, 0.3), "esc_temperature": (36, 0.3),
    "control_thread_cpu": (40, 0.5), "taurus_thread_cpu": (30, 0.5), "cpu_temperature": (41, 0.3), "capacitor_temperature": (40, 0.3),
    "fet_temperature": (45, 0.3), "vin_rms_ripple": (1, 0.03), "vin_pp_ripple": (2, 0.06), "torque_iq": (0, 0), "rpm": (3300, 0),
}
STATUS, STATE = 0x40120000, 0x3


@dataclasses.dataclass
class Cause:
    """What changes before a fault.  lead: so many messages before it; shape: step, ramp or pulse; flag: a bit, of status_flags"""
    message: str
    field: str
    lead: int
    shape: str
    size: float
    flag: int = 0

    def change(self, behind):
        """By how much the value differs from the usual one in the message this far behind the first that does; None: it does not."""
        if behind < 0 or self.shape == "pulse" and behind >= 3:
            return 0
        return self.size * (behind + 1 if self.shape == "ramp" else 1)


def random_cause(rng):
    message = rng.choice(["motor"] * 4 + ["health", "command"])
    lead = rng.randrange(1, {"motor": 30, "health": 8, "command": 60}[message])
    if message == "motor" and rng.random() < 0.2:
        return Cause(message, "status_flags", lead, "step", 1, rng.choice([bit for bit in model.STATUS if bit != 0x20000]))
    field, size, (low, high, _) = rng.choice([row for row in model.MESSAGES[ID[message]][2] if model.is_float(row[2])])
    step = (high - low) / (2 ** (8 * size) - 6)
    shape = rng.choice(["step", "step", "ramp", "pulse"]) if lead > 4 else "step"
    return Cause(message, field, lead, shape, rng.choice([-1, 1]) * rng.uniform(15, 25) * max(USUAL[field][1], step))


class Flight(flights.Flight):
    """Four controllers on two buses; at each time of FAULT_AT one of them has a fault."""

    def __init__(self, seed):
        self.rng, self.names, self.frames, self.sent = random.Random(f"cards {seed}"), BUSES, [], {}
        self.first, self.faulted = {}, {}  # by fault: the message that shows the cause first, and the fault's
        rng = self.rng
        self.begin = 1_700_000_000 * SECOND
        self.faults = [(at * SECOND, rng.randrange(4), random_cause(rng)) for at in FAULT_AT]
        for controller in range(4):
            for message in ("motor", "health"):
                self.send(controller // 2, message, controller)
        for bus in range(2):
            self.send(bus, "command", None)
        self.frames.sort(key=lambda frame: frame.at)
        for number, frame in enumerate(self.frames, 1):
            frame.number = number

    def send(self, bus, message, controller):
        """All messages of a source, with what is planted in them."""
        period, ident = PERIOD[message], ID[message] + (controller or 0)
        first = self.rng.randrange(period)
        times = range(first, LENGTH * SECOND, period)
        planted = []
        for place, (at, who, cause) in enumerate(self.faults):
            own = cause.message == message and (who == controller or message == "command" and who // 2 == bus)
            fault = -(-(at - first) // period) if message == "motor" else (at - first) // period  # the message with the fault, or the last before
            planted.append((who == controller, fault, cause if own else None))
            if own:
                self.first[place] = bus, ident, fault - cause.lead
            if message == "motor" and who == controller:
                self.faulted[place] = bus, ident, fault
        for index, time in enumerate(times):
            values = {name: self.rng.gauss(*USUAL[name]) for name in USUAL}
            status, fault, state = STATUS, 0, STATE
            for is_own, number, cause in planted:
                if cause and number - cause.lead <= index <= number + 3:
                    change = cause.change(index - number + cause.lead)
                    status ^= cause.flag if change else 0
                    if not cause.flag:
                        values[cause.field] += change
                if message == "motor" and is_own and number <= index < number + 3:
                    fault, state = 0x10000, STATE | 0x20
            self.add(bus, ident, message, time, self.payload(message, values, time, status, fault, state), index)

    @staticmethod
    def payload(message, values, time, status, fault, state):
        parts = []
        for name, size, kind in model.MESSAGES[ID[message]][2]:
            if model.is_float(kind):
                low, high, _ = kind
                count = round((values[name] - low) / (high - low) * (2 ** (8 * size) - 6))
                parts.append(max(0, min(count, 2 ** (8 * size) - 6)).to_bytes(size, "little"))
            else:
                numbers = {"timestamp": time, "status_flags": status, "fault_flags": fault, "motor_state": state, "enabled": 1, "key": 0xA5}
                parts.append(numbers.get(name, 1).to_bytes(size, "little"))
        return b"".join(parts)

    def add(self, bus, ident, message, time, payload, index):
        sent = Sent(ident, 0, 0, payload)
        frames = [sent.frame(SINGLE, payload)] if message == "command" else sent.frames()
        placed = [flights.Placed(one.can_id, one.data, bus=bus, at=self.begin + time + 200_000 * place) for place, one in enumerate(frames)]
        self.frames += placed
        self.sent[bus, ident, index] = placed[-1], payload


def value_in(message, payload, field):
    size, kind, count = next(row for name, *row in model.MESSAGES[ID[message]].counts(payload) if name == field)
    return model.value(count, size, kind[0], kind[1]) if model.is_float(kind) else count


@pytest.fixture(scope="module")
def cards():
    folder = tshark.writable_folder()

    def get(seed, *whats):
        flight = Flight(seed)
        capture = flight.write(folder / f"{seed}.pcapng", "pcapng")
        taps = [word for what in whats for word in ("-z", f"yapp,{what}")]
        done = tshark.run("-q", "-r", capture, "-o", "yapp.motor_ids:0x210-0x213", "-o", "yapp.health_ids:0x200-0x203", *taps)
        return flight, done.stdout

    return get


@pytest.mark.parametrize("seed", range(levels.size(2, 60)))
def test_what_departed_first(cards, seed):
    flight, text = cards(seed, *(f"fault,{number},json" for number in range(1, len(FAULT_AT) + 1)))
    lines = [json.loads(line) for line in text.splitlines()]
    assert len(lines) == len(FAULT_AT)
    frames = [flight.sent[flight.faulted[number]][0].number for number in range(len(FAULT_AT))]
    assert cards(seed, *(f"fault,frame={frame},json" for frame in frames))[1] == text
    for number, card in enumerate(lines):
        (bus, ident, _), (_, _, cause) = flight.faulted[number], flight.faults[number]
        frame, (shown, payload) = flight.sent[flight.faulted[number]][0], flight.sent[flight.first[number]]
        assert (card["incident"], card["incidents"], card["frame"], card["bus"], card["id"]) == (number + 1, 4, frame.number, BUSES[bus], ident)
        before = [change for change in card["changes"] if change["frame"] != frame.number]
        assert before, cause
        first = before[0]
        flag = model.STATUS[cause.flag] if cause.flag else None
        assert (first["message"], first["field"], first["flag"], first["frame"]) == (cause.message, cause.field, flag, shown.number), (cause, before)
        assert first["since"] == pytest.approx((shown.at - frame.at) / 1e9, abs=1e-9)
        sent = value_in(cause.message, payload, cause.field)
        if cause.flag:
            assert (first["from"], first["to"]) == tuple(int(bool(bits & cause.flag)) for bits in (STATUS, sent))
        else:
            assert first["to"] == pytest.approx(sent, abs=1e-6)
            assert abs(first["from"] - USUAL[cause.field][0]) <= abs(cause.size) / 8
        assert len(before) == 1, (cause, before)  # nothing else is accused
