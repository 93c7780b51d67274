# SPDX-License-Identifier: GPL-2.0-or-later
"""What recorders do to time stamps: they give all packets the same one, those of whole seconds, or those of packets that hold
several messages; and somebody sets the recorder's clock."""
import decimal
import json
import random
import re
import struct

import pytest

import flights
import levels
import stream_captures
import tshark

CASES = tshark.CAPTURES / "cases"
EQUAL = ("all packets of this capture have the same time stamp: how long faults, gaps and silences lasted is not known, "
         "and a message that was recorded twice counts twice")
FLIGHT = flights.make(3)


def z(path, what, *arguments):
    done = tshark.run("-q", "-r", path, *arguments, "-z", f"yapp,{what}", check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("stamp", ["0000000000.000000", "1700000000.250000"])
def test_no_fault_is_missed(folder, stamp):
    """A flight with many faults: their order stays, how long they lasted is not known."""
    path = folder / "flight.log"
    FLIGHT.write(path, "candump")
    text, count = re.subn(r"(?m)^\(\d+\.\d+\)", f"({stamp})", path.read_text())
    assert count > 1000
    path.write_text(text)
    code, printed, said = z(path, "faults,json", "-z", "yapp,check,silence=0,stale=0,jump=0", *FLIGHT.arguments("candump"))
    rows = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
    truth = FLIGHT.truth("candump")["faults"]
    keys = ("frame", "bus", "id", "field", "flag", "event")
    assert truth and [[row[key] for key in keys] for row in rows] == [[fault[key] for key in keys] for fault in truth]
    assert {row["active"] for row in rows} == {None} and EQUAL in said
    assert code == 21 and not re.search("(?m)^(FAILED|ok) +(silence|stale|jump)", printed)


# The clock is set forward ----------------------------------------------------------------------------------------------

@pytest.mark.parametrize("seed", range(levels.size(3, 20)))
def test_a_clock_that_is_set_changes_no_length(folder, seed):
    """A flight with faults, reboots and silences: its events and cards are the same, but for a step of the clock."""
    rng = random.Random(f"set {seed}")
    flight = flights.make(seed, is_clean=seed % 3 == 0)
    arguments, plain, path = flight.arguments("candump"), folder / "plain.log", folder / "set.log"
    flight.write(plain, "candump")
    ahead, lines = round(10 ** rng.uniform(1.1, 6)), plain.read_text().splitlines()
    at = rng.randrange(len(lines) // 4, len(lines) * 3 // 4)
    rows = [line[1:].split(")", 1) for line in lines]
    path.write_text("".join(f"({decimal.Decimal(stamp) + (ahead if number >= at else 0)}){rest}\n"
                            for number, (stamp, rest) in enumerate(rows)))

    def read(capture, kinds):
        _, printed, said = z(capture, "events,json", "-z", "yapp,fault,json", "-z", "yapp,summary", *arguments)
        lines = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
        rows, card = [line for line in lines if "kind" in line], next(line for line in lines if "incidents" in line)
        seconds = [row["since"] for section in card.values() if isinstance(section, list) for row in section if "since" in row]
        seconds.append(float(re.search(r"sources in (\S+) s", printed)[1]))
        times = ("time", "active", "length")
        return [{key: row[key] for key in row if key not in times} for row in rows if row["kind"] not in kinds], \
            [row[key] for row in [*rows, card] for key in times[1:] if row.get(key) and row.get("kind") not in kinds] + seconds, \
            [row["length"] for row in rows if row["kind"] == "clock"], said.replace("plain.log", "set.log")
    expected, lengths, clocks, said = read(plain, ())
    found, found_lengths, found_clocks, found_said = read(path, ("clock",))
    assert found == expected and said == found_said and not clocks
    assert len(lengths) == len(found_lengths) and all(abs(a - b) < 0.1 for a, b in zip(lengths, found_lengths))
    assert len(found_clocks) == 1 and abs(found_clocks[0] - ahead) < 0.1


MOTOR_IDS = ["-o", "yapp.motor_ids:0x210-0x213"]


def controllers(count, seconds):
    """The messages of controllers at 10 Hz, and Commands that repeat: (seconds, frame)."""
    sent = [(number * 0.1 + 0.01, stream_captures.frame(0, bytes.fromhex("01A501FD7FD483"))) for number in range(seconds * 10)]
    for controller in range(count):
        for number in range(seconds * 10):
            at = number * 0.1 + controller * 0.03
            payload = struct.pack("<6HBBIIqBB", *[32765] * 6, 70, 1, 0x40010000, 0, round(at * 1e9), 2, 80)
            sent.append((at, stream_captures.frame(0x210 + controller, payload, seq=number % 256)))
    return sorted(sent)


def write_packets(path, packets, link):
    """Packets of (seconds, bytes)."""
    made, sequence = [], 1000
    for at, data in packets:
        packet = stream_captures.Packet(data, stream_captures.Origin(stream_captures.ETHERNET, 0, 0))
        packet.time, packet.sequence = stream_captures.EPOCH + round(at * 1e6), sequence
        sequence += len(data)
        made.append(packet)
    stream_captures.Capture("", made, link, []).write(path)


def test_a_gap_is_no_step_of_the_clock(folder):
    """The recorder was away for 20 s: all were silent for it, who has a clock and who has none."""
    for begin in (19.99, 20.005, 20.02):  # another message is the first behind it
        packets = [row for row in controllers(2, 60) if not begin < row[0] < begin + 20]
        write_packets(folder / "run.pcapng", packets, stream_captures.udp)
        code, printed, _ = z(folder / "run.pcapng", "events,json", *MOTOR_IDS)
        events = [json.loads(line) for line in printed.splitlines()]
        assert code == 0 and sorted((row["kind"], row["id"]) for row in events) == [("missing", 0x210), ("missing", 0x211)] + \
            [("silence", ident) for ident in (0, 0x210, 0x211)]


@pytest.mark.parametrize("seed", range(levels.size(3, 20)))
def test_a_clock_that_is_set_forward_and_back(folder, seed):
    """To what it was, or less: behind that a silence is one, and others are none."""
    rng = random.Random(f"back {seed}")
    ahead, length, rest = rng.uniform(13, 16), rng.uniform(1, 8), rng.choice([0, rng.uniform(2, 13)])
    begin = 4 + ahead - rng.uniform(0, length)
    sent = [row for row in controllers(2, 40) if not (begin < row[0] < begin + length and row[1][4:6] == b"\x11\2")]
    write_packets(folder / "run.pcapng", [(at + (0 if at < 4 else ahead if at < 8 else rest), data) for at, data in sent], stream_captures.udp)
    code, printed, _ = z(folder / "run.pcapng", "events,json", *MOTOR_IDS)
    events = [json.loads(line) for line in printed.splitlines()]
    silent = [at for at, data in sent if data[4:6] == b"\x11\2"]
    gap = max(after - before for before, after in zip(silent, silent[1:]))
    assert code == 0 and {(row["kind"], row["id"]) for row in events} == {("clock", None), ("missing", 0x211), ("silence", 0x211)}
    assert [round(row["length"] - gap, 3) for row in events if row["kind"] == "silence"] == [0]


# Coarse stamps ---------------------------------------------------------------------------------------------------------

COARSE = "time stamps are those of packets, or too coarse: how long faults, gaps and silences lasted is not known"
ABOUT_TIME = ("silence", "stale", "jump")


def assert_not_judged(path, *arguments, faults=()):
    """Rules about time are not judged, all others hold; nothing is late, silent, missing or a copy; one line says why."""
    rules = "check,json,crc=0,incomplete=0,missing=0,shared=0,reboot=0,clock=0,silence=0,stale=0,jump=0,copies=0,motor.rate=9..11"
    code, printed, said = z(path, rules, *arguments, "-z", "yapp,events,json")
    lines = [json.loads(line) for line in printed.splitlines()]
    rows, events = ([line for line in lines if key in line] for key in ("ok", "kind"))
    assert code == 21 and rows, [row for row in rows if row["ok"] is False]
    for row in rows:
        kind = row["rule"].split("=")[0]
        assert row["ok"] is (None if kind in (*ABOUT_TIME, "motor.rate") else True), row
    assert said.count(COARSE) == 1 and "hide" not in said and "twice" not in said
    assert [(row["kind"], row["event"]) for row in events] == list(faults)


@pytest.mark.parametrize("seed", range(levels.size(2, 12)))
def test_flights_with_coarse_stamps(folder, seed):
    """Of whole or of half seconds."""
    rng = random.Random(f"coarse {seed}")
    flight, path = flights.make(seed, True), folder / "run.log"
    flight.write(path, "candump")
    step = rng.choice([0.5, 1, 2])
    lines = [line[1:].split(")", 1) for line in path.read_text().splitlines()]
    path.write_text("".join(f"({float(stamp) // step * step:.6f}){rest}\n" for stamp, rest in lines))
    assert_not_judged(path, *flight.arguments("candump"))


@pytest.mark.parametrize("seed", range(levels.size(4, 24)))
def test_messages_packed_into_packets(folder, seed):
    """A bridge packs what came, in UDP and TCP: of two controllers, and Commands that repeat."""
    rng = random.Random(f"packed {seed}")
    sent, packets, most = controllers(rng.choice([1, 2]), 6), [], rng.choice([8, 20, 40])
    while sent:
        count = rng.randrange(1, most)
        packets.append((sent[:count][-1][0], b"".join(data for _, data in sent[:count])))
        sent = sent[count:]
    write_packets(folder / "run.pcapng", packets, rng.choice([stream_captures.udp, stream_captures.tcp]))
    assert_not_judged(folder / "run.pcapng", *MOTOR_IDS)
