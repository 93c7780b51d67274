# SPDX-License-Identifier: GPL-2.0-or-later
"""CAN error frames: each change of a bus is an event and counts in `check`, however the capture holds the frames."""
import collections
import json
import random
import struct

import pytest

import can_generator
import capture_file
import levels
import tshark
from test_buses import BEGIN, Placed, interfaces, motor, packet

pytestmark = levels.by_version
CASES = tshark.CAPTURES / "cases"
ERROR, REMOTE, EXTENDED = 0x20000000, 0x40000000, 0x80000000
ROUNDS = 60  # of Motor Data, at 10 Hz


def said(path, *arguments, stdin=None):
    """The events of a capture."""
    done = tshark.run("-r", path, "-q", "-z", "yapp,events,json", *arguments, check=False, stdin=stdin)
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def on_buses(events):
    return [(event["bus"], event["what"], event["frame"]) for event in events if event["kind"] == "bus"]


def failed(rows):
    """The rules that failed with their counts."""
    return {row["rule"].split("=")[0]: row["seen"] for row in rows if row.get("ok") is False}


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
    """Two buses with a controller each, others' frames, and error frames: in bursts, and far apart."""
    frames = []
    for bus in (0, 1):
        for at in range(ROUNDS):
            sent = can_generator.Sent(0x210, 0, 0, motor(1000 + at, 0)).frames()
            frames += [Placed(BEGIN + at * 100_000 + 200 * part + bus * 7, bus, one.can_id | EXTENDED, one.data)
                       for part, one in enumerate(sent)]
        frames += [Placed(BEGIN + at * 700_000 + 50_000 + bus * 7, bus, 0x123, b"other") for at in range(ROUNDS // 7)]
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


def record(one, order=">"):
    return struct.pack(order + "IB3x", one.can_id, len(one.data)) + one.data.ljust(8, b"\0")


def log(frames):
    """An id has three digits if it is a standard one, and no flag of an extended one."""
    return "".join(f"({one.time // 10**6}.{one.time % 10**6:06d}) can{one.bus} "
                   f"{one.can_id & ~EXTENDED:0{8 if one.can_id > 0x7FF else 3}X}#{one.data.hex().upper()}\n" for one in frames).encode()


# Form: how it is written, the names of its buses.
FORMS = {
    "pcapng": (lambda frames: interfaces(["can0", "can1"]) + b"".join(packet(one.time, one.bus, record(one)) for one in frames), ["can0", "can1"]),
    "pcap": (lambda frames: capture_file.pcap(capture_file.SOCKETCAN, [(one.time, record(one)) for one in frames if one.bus == 0]), [None]),
    "sll.pcap": (lambda frames: capture_file.pcap(capture_file.SLL, [(one.time, capture_file.sll(record(one, "<"))) for one in frames if one.bus == 0]), [None]),
    "sll2.pcap": (lambda frames: capture_file.pcap(capture_file.SLL2, [(one.time, capture_file.sll2(record(one, "<"), one.bus + 3)) for one in frames]), ["if0#3", "if0#4"]),
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
    rows = said(path, *random.Random(seed).choice([[], ["-2"]]), "-z", "yapp,check,json,bus_off=0,bus_passive=0,bus_errors=0",
                "-z", "yapp,buses,json")
    buses = {row["bus"]: [row["frames"], row["yapp"], sum(row["errors"].values())] for row in rows if "load" in row}
    kinds = [collections.Counter(one.can_id & (ERROR | EXTENDED) for one in frames if one.bus == bus) for bus in range(len(names))]
    assert buses == {name: [count[0] + count[EXTENDED], count[EXTENDED], count[ERROR]] for name, count in zip(names, kinds)}
    events = [row for row in rows if "kind" in row]
    # Changes of one frame come in no order that anybody needs.
    assert sorted(on_buses(events)) == sorted((names[bus], what, number) for bus, what, number in changes)
    assert sum(event["count"] for event in events if event["kind"] == "dropped") == dropped
    counts = {f"bus_{what}": sum(one[1] == what for one in changes) for what in ("off", "passive")}
    assert failed(rows) == {**counts, "bus_errors": errors}


def test_buses_of_captures_of_others():
    for name, errors in (("plain_errors.pcapng", {"protocol": 9}), ("no_ack.pcapng", {"no_ack": 50})):
        row = json.loads(tshark.run("-r", CASES / name, "-q", "-z", "yapp,buses,json").stdout)
        assert {what: count for what, count in row["errors"].items() if count} == errors and row["load"] is None
    done = tshark.run("-r", CASES / "bus_off.log", "-q", "-z", "yapp,buses,filter=frame.number > 111", "-z",
                      "yapp,check,bus_off=0,filter=yapp.id == 0x210", check=False)
    assert "can0     130  " in done.stdout and "1 off, 1 restarted" in done.stdout
    assert done.returncode == 20  # a filter of messages hides no bus off


# Error frames in ASC: of CAN, with an error code, and of CAN FD, with the frame in which it came.
IN_ASC = ["1  ErrorFrame", "1  ErrorFrame\tECC: 10100010", "CANFD   1 Tx   ErrorFrame Not Acknowledge error, dominant error flag   fffe c7 31ca",
          "CANFD   1 Rx   ErrorFrame Stuff Error          fffe 82     20aa Data 104       f6  1 0 5 5 19 85 fd df ff    81328       1b 98000000"]


def test_asc(folder):
    """Its error frames have no class; the states of a controller have lines of their own."""
    path = folder / "errors.asc"
    lines = [f" {0.1 * at:.6f} {IN_ASC[at // 5] if at % 5 == 2 else '1  123             Rx   d 1 01'}" for at in range(20)]
    path.write_text("date Tue Nov 14 22:13:20.000 2023\nbase hex  timestamps absolute\n" + "\n".join(lines) + "\n")
    rows = said(path, "-z", "yapp,buses,json", "-z", "yapp,check,json,bus_errors=3")
    row = next(row for row in rows if "load" in row)
    assert [row["bus"], row["frames"], row["errors"]["bus"], sum(row["errors"].values())] == ["CAN-1", 16, 4, 4]
    assert failed(rows)["bus_errors"] == 4
    states = ["error active", "warning level", "error passive - TxErr: 132 RxErr: 0", "busoff", "error active"]
    lines[1:1] = [f" 0.0{at} CAN 1 Status:chip status {state}" for at, state in enumerate(states, 1)]
    path.write_text("base hex  timestamps absolute\n" + "\n".join(lines) + "\n")
    rows = said(path, "-z", "yapp,check,json,bus_off=0,bus_passive=0")
    assert on_buses(row for row in rows if "kind" in row) == [("CAN-1", "passive", 3), ("CAN-1", "off", 4)]
    assert failed(rows) == {"bus_off": 1, "bus_passive": 1}


@pytest.mark.parametrize("order, arguments", [(">", []), ("<", ["-o", "can.byte_swap:TRUE"])])  # a preference of Wireshark's
@pytest.mark.parametrize("flag", [0, EXTENDED, REMOTE, EXTENDED | REMOTE])
def test_records_of_other_recorders(folder, flag, order, arguments):
    """Also an error frame with the flag of an extended or of a remote frame is one, and has a time where no packet follows."""
    frame = error(0, 0, "off")
    (folder / "run.pcap").write_bytes(capture_file.pcap(capture_file.SOCKETCAN, [(BEGIN, record(frame._replace(can_id=frame.can_id | flag), order))]))
    assert [(row["kind"], row["what"], row["time"]) for row in said(folder / "run.pcap", *arguments)] == [("bus", "off", BEGIN / 10**6)]


@pytest.mark.parametrize("link", [1, 147])  # Ethernet, DLT_USER
def test_packets_of_others_with_the_same_bytes(folder, link):
    """They are no error frames, and none that Wireshark 4.6 refuses."""
    bodies = [record(error(0, 0, "off")), struct.pack(">IB3x", EXTENDED | 1, 52) + bytes(52)]
    (folder / "others.pcap").write_bytes(capture_file.pcap(link, [(BEGIN + at, body) for at, body in enumerate(bodies)]))
    rows = said(folder / "others.pcap", "-z", "yapp,check,json,bus_errors=0,dropped=0")
    assert rows and not [row for row in rows if row.get("seen") or "kind" in row]


def test_near(folder):
    """A fault, a silence and a loss name the bus events of their bus that come within a second."""
    frames = []
    for bus in (0, 1):
        for at in range(ROUNDS):
            if 20 <= at < 28:
                continue
            sent = can_generator.Sent(0x210, 0, 0, motor(1000 + at, 0x10000 if at == 40 else 0)).frames()
            sent = sent[:-1] if at == 50 else sent
            frames += [Placed(BEGIN + at * 100_000 + 200 * part + bus * 7, bus, one.can_id | EXTENDED, one.data) for part, one in enumerate(sent)]
    for time, what in ((0.85, "passive"), (0.95, "off"), (3.05, "restarted"), (3.85, "passive"), (5.5, "no_ack")):
        frames.append(error(BEGIN + int(time * 1e6), 0, what))
    path = folder / "near.pcapng"
    path.write_bytes(FORMS["pcapng"][0](sorted(frames)))
    rows = said(path, "-z", "yapp,faults,json")
    found = [(row["bus"], row["kind"], row.get("near")) for row in rows if row.get("kind", "bus") != "bus"]
    assert found == [
        ("can0", "silence", "bus off at 0.950 s, restarted at 3.050 s"), ("can1", "silence", None),
        ("can0", "fault", "bus restarted at 3.050 s, passive at 3.850 s"), ("can1", "fault", None),
        ("can0", "fault", "bus passive at 3.850 s"), ("can1", "fault", None),
        ("can0", "incomplete", "bus no_ack at 5.500 s"), ("can1", "incomplete", None)]
    assert [row.get("near") for row in rows if "kind" not in row] == [near for _, kind, near in found if kind == "fault"]
    listed = tshark.run("-q", "-r", path, "-z", "yapp,faults").stdout
    assert all(f"  {near}\n" in listed for _, kind, near in found if kind == "fault" and near)
