# SPDX-License-Identifier: GPL-2.0-or-later
"""Recorders that hold messages twice: each counts once, and so does its fault."""
import functools
import json
import random
import shutil

import pytest

import flights
import levels
import model
import tshark

CASES = tshark.CAPTURES / "cases"
CLOCKLESS = [message.name for message in model.MESSAGES.values() if not message.has_clock]
FLIGHT = flights.make(5, True)  # a clean one
FAULTY = flights.make(3)


def z(path, what, *arguments):
    done = tshark.run("-q", "-r", path, *arguments, "-z", f"yapp,{what}", check=False)
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")], done.stderr


def summary_and_faults(path, *arguments):
    """The rows of both, in one run, and what is said."""
    _, rows, said = z(path, "summary,json", *arguments, "-z", "yapp,faults,json")
    return [row for row in rows if "event" not in row], [row for row in rows if "event" in row], said


# file, good Motor Data, their copies, messages that have some
FILES = [("c05_twice_TR.log", 12, 12, 21), ("c05_twice.pcapng", 12, 12, 21), ("can_each_twice.pcap", 20, 20, 33),
         ("udp_each_twice.pcap", 20, 20, 24), ("any_udp_three_interfaces.pcap", 20, 40, 24),
         ("wifi_monitor_retries.pcap", 20, 4, 4), ("tcp_two_clients.pcap", 20, 20, 24)]


@levels.by_version
@pytest.mark.parametrize("name, motor, copies, messages", FILES, ids=lambda value: str(value))
def test_each_message_counts_once(name, motor, copies, messages):
    """The fault, too; nobody seems to share the ID, and no clock stands still."""
    path = CASES / name
    rule = f"check,json,copies={copies},fault=0,shared=0,stale=0,incomplete=0,silence=0"
    code, lines, said = z(path, "summary,json", "-z", "yapp,faults,json", "-z", f"yapp,{rule}")
    assert [(row["count"], row["copies"], row["incomplete"]) for row in lines if row["message"] == "motor" and "count" in row] == [(motor, copies, 0)]
    assert f"{messages} messages were recorded twice; each counts once" in said
    assert [fault["event"] for fault in lines if "event" in fault] == ["raised", "cleared"]
    assert code == 20 and [row["rule"] for row in lines if row.get("ok") is False] == ["fault=0"]
    shown = tshark.fields(path, ["frame.number", "yapp.copy_of"], "-2", "-Y", "yapp.copy")
    assert sum(row[1].count(",") + 1 for row in shown) >= copies
    assert all(int(of) < int(number) or name.startswith("udp") for number, of in shown for of in of.split(","))


def doubled(text, seed, how, share):
    """Lines of a candump log with copies: of each frame at once or 0.25 ms later, of each message behind its last frame, or of a
    share of them."""
    chance, lines, message = random.Random(seed), [], {}
    for line in text.splitlines():
        stamp, bus, data = line.split()[:3]
        delay = 2.5e-4 if how == "later frames" else chance.uniform(0, 9e-5)
        later = f"({float(stamp[1:-1]) + delay:.6f}) {bus} {data}"
        lines.append((float(stamp[1:-1]), line))
        ident = int(data.split("#")[0], 16)
        key, ctrl = (bus, ident >> 18, ident & 0xFF), ident >> 14 & 15
        message.setdefault(key, []).append(later)
        if "frames" in how:
            lines += [(float(one.split()[0][1:-1]), one) for one in [later] if chance.random() < share]
        elif ctrl in (0, 3):
            stamps = [float(stamp[1:-1]) + 0.001 + index * 1e-5 for index in range(len(message[key]))]
            if chance.random() < share:
                lines += [(at, f"({at:.6f}) {' '.join(one.split()[1:])}") for at, one in zip(stamps, message[key])]
            message[key] = []
    return "".join(line + "\n" for _, line in sorted(lines, key=lambda row: row[0]))


@functools.lru_cache(None)
def of_once(flight):
    """The candump log of a flight, and what summary and faults have of it."""
    folder = tshark.writable_folder()
    flight.write(folder / "single.log", "candump")
    found = (folder / "single.log").read_text(), *summary_and_faults(folder / "single.log", *flight.arguments("candump"))[:2]
    shutil.rmtree(folder)
    return found


@levels.together("copies")
@pytest.mark.parametrize("how, share", [("frames", 1), ("later frames", 1), ("messages", 1), ("messages", 0.2)])
def test_a_flight_that_was_recorded_twice(folder, how, share):
    """The summary is that of the flight, copies apart, and so are the faults of one with faults."""
    for flight, seed in ((FLIGHT, 1), (FAULTY, 2))[:1 if "frames" in how else 2]:
        text, once, faults = of_once(flight)
        (folder / "twice.log").write_text(doubled(text, seed, how, share))
        keys = ("bus", "id", "count", "crc_bad", "incomplete") if flight is FLIGHT else ("bus", "id", "count", "reboots", "late")
        twice, found, _ = summary_and_faults(folder / "twice.log", *flight.arguments("candump"))

        def compared(rows):  # without a clock, one that came before any message with a clock had a copy counts twice
            return [[row[key] for key in keys] for row in rows if row["message"] not in CLOCKLESS]
        more = sum(row["count"] * (1 if rows is twice else -1) for rows in (once, twice) for row in rows if row["message"] in CLOCKLESS)
        assert 0 <= more <= 10
        assert compared(once) and compared(twice) == compared(once)
        copies, total = sum(row["copies"] for row in twice), sum(row["count"] for row in once)
        assert copies + more >= total if share == 1 else 0.1 * total < copies < 0.4 * total
        assert sum(row["copies"] for row in once) == 0
        events = [[(line["bus"], line["id"], line["flag"], line["event"]) for line in lines] for lines in (found, faults)]
        assert events[0] == events[1] and (events[0] != []) == (flight is FAULTY)
