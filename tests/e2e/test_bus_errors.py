# SPDX-License-Identifier: GPL-2.0-or-later
"""CAN error frames: each change of a bus is an event and counts in `check`, however the capture holds the frames."""
import json
import random
import struct

import pytest

import can_generator
import levels
import tshark
from test_buses import BEGIN, Placed, interfaces, log, motor, packet, pcap

pytestmark = levels.by_version
CASES = tshark.CAPTURES / "cases"
ERROR, EXTENDED = 0x20000000, 0x80000000
ROUNDS = 60  # of Motor Data, at 10 Hz


def said(path, *arguments, stdin=None):
    """The events of a capture."""
    done = tshark.run("-r", path, "-q", "-z", "yapp,events,json", *arguments, check=False, stdin=stdin)
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def on_buses(events):
    return [(event["bus"], event["what"], event["frame"]) for event in events if event["kind"] == "bus"]


def failed(path, *rules):
    """The exit code of `check`, and the rules that failed with their counts."""
    done = tshark.run("-r", path, "-q", "-z", ",".join(["yapp,check,json", *rules]), check=False)
    rows = map(json.loads, done.stdout.splitlines())
    return done.returncode, {row["rule"].split("=")[0]: row["seen"] for row in rows if row["ok"] is False}


# Captures of others ------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", ["bus_off.pcapng", "bus_off.log"])
def test_bus_off(name):
    events = said(CASES / name)
    assert on_buses(events) == [("can0", "passive", 106), ("can0", "off", 112), ("can0", "restarted", 113)]
    assert failed(CASES / name) == (20, {"bus_off": 1, "bus_passive": 1, "silence": 1})
    assert [event["near"] for event in events if event["kind"] == "silence"] == \
        ["bus passive at 2.050 s, off at 2.110 s, restarted at 3.300 s"]


def test_no_bus_event_is_one_of_an_id():
    assert {(event["id"], event["message"]) for event in said(CASES / "bus_off.pcapng") if event["kind"] == "bus"} == {(None, None)}


def test_plain_errors():
    path = CASES / "plain_errors.pcapng"
    assert said(path) == [] and failed(path) == (0, {})
    assert failed(path, "bus_errors=9") == (0, {}) and failed(path, "bus_errors=8") == (20, {"bus_errors": 9})


def test_no_acknowledgement():
    assert on_buses(said(CASES / "no_ack.pcapng")) == [("can0", "no_ack", 2)]


# Random error frames -----------------------------------------------------------------------------------------------------

# Name: class, and the second data byte.
REPORTS = {
    "off": (0x40, 0), "restarted": (0x100, 0), "no_ack": (0x20, 0), "tx_timeout": (0x01, 0), "arbitration": (0x02, 0),
    "protocol": (0x88, 0), "transceiver": (0x10, 0), "counters": (0x200, 0), "overflow": (0x04, 0x01), "sent too many": (0x04, 0x02),
    "warning": (0x204, 0x08), "receiver warns": (0x04, 0x04), "passive": (0x204, 0x20), "receiver passive": (0x04, 0x10),
    "active": (0x04, 0x40), "no_ack and protocol": (0xA8, 0), "passive, no_ack": (0x224, 0x30),
}


def error(time, bus, name):
    kind, state = REPORTS[name]
    return Placed(time, bus, ERROR | kind, bytes([0, state, 0, 0, 0, 0, 96, 0]))


def flight(rng):
    """Two buses with a controller each, and error frames: in bursts, and far apart."""
    frames = []
    for bus in (0, 1):
        for at in range(ROUNDS):
            sent = can_generator.Sent(0x210, 0, 0, motor(1000 + at, 0)).frames()
            frames += [Placed(BEGIN + at * 100_000 + 200 * part + bus * 7, bus, one.can_id, one.data) for part, one in enumerate(sent)]
        time = 0
        while (time := time + rng.choice([1_000, 30_000, 30_000, 200_000, 1_200_000])) < ROUNDS * 100_000:
            name = rng.choice(list(REPORTS))
            frames += [error(BEGIN + time + 9 + bus * 7 + 1000 * copy, bus, name) for copy in range(rng.choice([1, 1, 4]))]
    return sorted(frames)


def truth(frames):
    """What must be told: changes [(bus, what, frame)], frames that the controllers dropped, error frames."""
    changes, dropped, errors, broken, last = [], 0, 0, {}, {}
    for number, one in enumerate(frames, 1):
        if not one.can_id & ERROR:
            continue
        kind, state = one.can_id ^ ERROR, one.data[1] if one.can_id & 4 else 0
        errors, dropped = errors + 1, dropped + bool(state & 3)
        new = "off" if kind & 0x40 else "passive" if state & 0x30 else "restarted" if kind & 0x100 else "" if state & 0x4C else None
        if new is not None and new != broken.get(one.bus, ""):
            broken[one.bus] = new
            if new:
                changes.append((one.bus, new, number))
            if new != "passive":
                last = {key: when for key, when in last.items() if key[0] != one.bus}
        for what, bit in (("no_ack", 0x20), ("tx_timeout", 0x01)):
            if kind & bit:
                if one.time - last.get((one.bus, what), -2_000_000) > 1_000_000:
                    changes.append((one.bus, what, number))
                last[one.bus, what] = one.time
    return changes, dropped, errors


def word(one):
    return one.can_id if one.can_id & ERROR else one.can_id | EXTENDED


def record(one, order=">"):
    return struct.pack(order + "IB3x", word(one), len(one.data)) + one.data.ljust(8, b"\0")


def sll2(one):
    return struct.pack(">HHIHBB8x", 0x0C, 0, one.bus + 3, 280, 0, 0) + record(one, "<")


def sll(one):
    return struct.pack(">HHH8xH", 4 * one.bus, 280, 0, 0x0C) + record(one, "<")



# Form: how it is written, the names of its buses.
FORMS = {
    "pcapng": (lambda frames: interfaces(["can0", "can1"]) + b"".join(packet(one.time, one.bus, record(one)) for one in frames), ["can0", "can1"]),
    "pcap": (lambda frames: pcap(227, [(one.time, record(one)) for one in frames if one.bus == 0]), [None]),
    "sll.pcap": (lambda frames: pcap(113, [(one.time, sll(one)) for one in frames if one.bus == 0]), [None]),
    "sll2.pcap": (lambda frames: pcap(276, [(one.time, sll2(one)) for one in frames]), ["if0#3", "if0#4"]),
    "log": (log, ["can0", "can1"]),
}


@pytest.mark.parametrize("seed", range(levels.size(2, 12)))
@pytest.mark.parametrize("form", FORMS)
def test_random_error_frames(folder, form, seed):
    write, names = FORMS[form]
    frames = [one for one in flight(random.Random(seed)) if one.bus < len(names)]
    changes, dropped, errors = truth(frames)
    assert len(changes) > 5 and errors > 20
    path = folder / f"errors.{form}"
    path.write_bytes(write(frames))
    events = said(path, *random.Random(seed).choice([[], ["-2"]]))
    # Changes of one frame come in no order that anybody needs.
    assert sorted(on_buses(events)) == sorted((names[bus], what, number) for bus, what, number in changes)
    assert sum(event["count"] for event in events if event["kind"] == "dropped") == dropped
    counts = {f"bus_{what}": sum(one[1] == what for one in changes) for what in ("off", "passive")}
    assert failed(path, "bus_off=0", "bus_passive=0", "bus_errors=0") == (20, {**counts, "bus_errors": errors})


def test_a_pipe(folder):
    frames = flight(random.Random(3))
    path = folder / "errors.pcapng"
    path.write_bytes(FORMS["pcapng"][0](frames))
    with path.open("rb") as stdin:
        found = on_buses(said("-", stdin=stdin))
    assert [(what, number) for _, what, number in found] == [(what, number) for _, what, number in truth(frames)[0]]


def test_a_filter_narrows_them(folder):
    rows = [failed(CASES / "bus_off.pcapng", "bus_off=0", f"filter=frame.number < {number}")[0] for number in (112, 113)]
    assert rows == [0, 20]


def test_near(folder):
    """A fault, a silence and a loss name the bus events of their bus that come within a second."""
    frames = []
    for bus in (0, 1):
        for at in range(ROUNDS):
            if 20 <= at < 28:
                continue
            sent = can_generator.Sent(0x210, 0, 0, motor(1000 + at, 0x10000 if at == 40 else 0)).frames()
            sent = sent[:-1] if at == 50 else sent
            frames += [Placed(BEGIN + at * 100_000 + 200 * part + bus * 7, bus, one.can_id, one.data) for part, one in enumerate(sent)]
    for time, what in ((0.85, "passive"), (0.95, "off"), (3.05, "restarted"), (3.85, "passive"), (5.5, "no_ack")):
        frames.append(error(BEGIN + int(time * 1e6), 0, what))
    path = folder / "near.pcapng"
    path.write_bytes(FORMS["pcapng"][0](sorted(frames)))
    found = [(event["bus"], event["kind"], event.get("near")) for event in said(path) if event["kind"] != "bus"]
    assert found == [
        ("can0", "silence", "bus off at 0.950 s, restarted at 3.050 s"), ("can1", "silence", None),
        ("can0", "fault", "bus restarted at 3.050 s, passive at 3.850 s"), ("can1", "fault", None),
        ("can0", "fault", "bus passive at 3.850 s"), ("can1", "fault", None),
        ("can0", "incomplete", "bus no_ack at 5.500 s"), ("can1", "incomplete", None)]
    rows = map(json.loads, tshark.run("-r", path, "-q", "-z", "yapp,faults,json").stdout.splitlines())
    assert [row.get("near") for row in rows] == [near for _, kind, near in found if kind == "fault"]
