# SPDX-License-Identifier: GPL-2.0-or-later
"""Which bus a frame was on, every client is told alike: tshark's one and two passes, and sharkd, which asks in any order.

None of them names a field of the bus in a filter: what they know, the file says.
"""
import collections
import functools
import gzip
import json
import random
import re
import struct
import subprocess

import pytest

import can_generator
import capture_file
import flights
import levels
import tshark
from test_sharkd import answers_of, details, filters_in, home, shutil  # noqa: F401 home, of a test

pytestmark = levels.by_version
FLIGHT = tshark.ROOT / "docs/flight.pcapng"
COLUMNS = ["-o", 'gui.column.format:"Source","%s","Info","%i"', "-T", "tabs"]
NAMES = ["yapp.source", "yapp.reassembled.in", "yapp.message.fault", "yapp.fragment", "yapp.time_delta"]
SECOND_LOOKS = [("-2",), ("-2", "-Y", "yapp")]
BEGIN = 1_700_000_000_000_000

Placed = collections.namedtuple("Placed", "time bus can_id data")  # microseconds, 0 or 1


# Captures --------------------------------------------------------------------------------------------------------

def flight():
    """The frames of docs/flight.pcapng."""
    data, at, frames = FLIGHT.read_bytes(), 0, []
    while at < len(data):
        kind, length = struct.unpack_from("<II", data, at)
        if kind == 6:
            bus, high, low = struct.unpack_from("<III", data, at + 8)
            can_id, size = struct.unpack_from(">IB", data, at + 28)
            frames.append(Placed(high << 32 | low, bus, can_id & 0x1FFFFFFF, data[at + 36:at + 36 + size]))
        at += length
    return frames


def motor(clock, fault):
    return struct.pack("<6HBBIIqBB", *[0x7FFD] * 6, 80, 1, 0x40120000, fault, clock * 100_000_000, 3, 80)


def turns():
    """Two controllers with the same ID, in turns.  The one on bus 0 has a fault in rounds 3 to 5, the other one boots before
    round 5, and a part of its round 2 is lost."""
    frames = []
    for at in range(9):
        payloads = motor(1000 + at, 0x10000 if 3 <= at < 6 else 0), motor(500 + at if at < 5 else at - 5, 0)
        sent = [can_generator.Sent(0x210, 0, 0, payload).frames() for payload in payloads]
        for part in range(5):
            for bus in (0, 1):
                if (at, bus, part) != (2, 1, 2):
                    frames.append(Placed(BEGIN + at * 100_000 + part * 1000 + bus * 100, bus, sent[bus][part].can_id,
                                         sent[bus][part].data))
    return frames


def record(one, little=False):
    return can_generator.Frame(one.can_id, one.data).record(little)


def interfaces(names, linktype=capture_file.SOCKETCAN):
    """The head of a pcapng file, one interface for each name."""
    return capture_file.section(*(capture_file.interface(linktype, name) for name in names))


def packet(time, interface, data):
    return capture_file.packet(time, data, interface)


def sll2(one):
    return capture_file.sll2(record(one, little=True), one.bus + 3)


def log(frames):
    return "".join(f"({one.time // 10**6}.{one.time % 10**6:06d}) can{one.bus} {one.can_id:08X}#{one.data.hex().upper()}\n"
                   for one in frames).encode()


FORMS = {
    "pcapng": lambda frames: interfaces(["can0", "can1"]) + b"".join(packet(one.time, one.bus, record(one)) for one in frames),
    "sll2.pcap": lambda frames: capture_file.pcap(capture_file.SLL2, [(one.time, sll2(one)) for one in frames]),
    "sll2.pcapng": lambda frames: interfaces(["any"], linktype=276) +
                   b"".join(packet(one.time, 0, sll2(one)) for one in frames),
    "log": log,
}
FORMS["pcapng.gz"] = lambda frames: gzip.compress(FORMS["pcapng"](frames))


def written(folder, frames, form):
    path = folder / f"buses.{form}"
    path.write_bytes(FORMS[form](frames))
    return path


# Clients ---------------------------------------------------------------------------------------------------------

def listed_and_told(path, *options, **more):
    """Source and Info of each frame, of which those of a first look have no "Reassembled in"; and the events."""
    lines = tshark.run("-r", path, *options, *COLUMNS, "-z", "yapp,events,json", **more).stdout.splitlines()
    return [tuple(cell.strip() for cell in line.split("\t")) for line in lines if not line.startswith("{")], \
        [json.loads(line) for line in lines if line.startswith("{")]


def listed(*arguments, **more):
    return listed_and_told(*arguments, **more)[0]


def without_links(rows):
    return [(source, re.sub(r"  \[Reassembled in #\d+\]", "", info)) for source, info in rows]


def events(path, *options, **more):
    """The lines of -z yapp,events,json."""
    found = tshark.run("-q", "-r", path, *options, "-z", "yapp,events,json", **more).stdout
    return [json.loads(line) for line in found.splitlines()]


def through_a_pipe(ask, path):
    with subprocess.Popen(["cat", path], stdout=subprocess.PIPE) as cat:
        return ask("-", stdin=cat.stdout)


def values(path, *options):
    """Of each frame { field: its values }."""
    return [{name: [tshark.truth(value) if name == "yapp.message.fault" else value for value in cell.split(",")]
             for name, cell in zip(NAMES, row) if cell} for row in tshark.fields(path, NAMES, *options)]


def values_of(texts):
    """The same of sharkd's filter expressions of a frame."""
    found = {}
    for text in texts:
        name, _, value = text.partition(" == ")
        if name in NAMES:
            value = value.strip('"')
            found.setdefault(name, []).append(tshark.truth(value) if name == "yapp.message.fault" else value)
    return {name: sorted(some) for name, some in found.items()}


def comparable(rows):
    """Source, links and faults; as fragments, that the last is the frame itself is told by neither in order."""
    return [{name: sorted(some) for name, some in row.items() if name != "yapp.time_delta"} for row in rows]


def assert_sharkd_says(home, path, rows, known, seed):
    """rows: of the packet list; known: values of each frame.  The details are asked for in any order, some twice."""
    order = list(range(1, len(rows) + 1)) if len(rows) < 200 else sorted(random.Random(seed).sample(range(1, len(rows)), 60))
    random.Random(seed).shuffle(order)
    order += order[:20]
    found = answers_of(home, path, *map(details, order[:3]), ("frames", {}), *map(details, order))
    assert [(row["c"][2], row["c"][6]) for row in found[3]] == rows
    for number, answer in zip([*order[:3], *order], [*found[:3], *found[4:]]):
        assert comparable([values_of(filters_in(answer))]) == comparable([known[number - 1]]), number


def asked(frames, known):
    """What has to be the same in all forms, whatever buses are called."""
    return [{name: some for name, some in row.items() if name != "yapp.source"} for row in known]


@functools.lru_cache(None)
def reference(make):
    folder = tshark.writable_folder()
    path = written(folder, make(), "pcapng")
    found = values(path, "-2"), [{**event, "bus": None} for event in events(path)]
    shutil.rmtree(folder)
    return found


# Tests -----------------------------------------------------------------------------------------------------------

@levels.each_once
@pytest.mark.parametrize("form", levels.few(list(FORMS), ["pcapng", "sll2.pcap", "log"]))
@pytest.mark.parametrize("make", [turns, flight], ids=lambda make: make.__name__)
def test_every_client(make, form, folder, home):
    frames = make()
    path = written(folder, frames, form)
    rows, told = listed_and_told(path, "-2")
    assert len(rows) == len(frames)
    assert len({source for source, _ in rows}) > (1 if "sll2" not in form else 0)
    assert listed_and_told(path) == (without_links(rows), told) and listed_and_told(path, "-2", "-Y", "yapp") == (rows, told)
    known = values(path, "-2")
    assert_sharkd_says(home, path, rows, known, form)
    expected, same = reference(make)
    assert asked(frames, known) == asked(frames, expected)
    assert [{**event, "bus": None} for event in told] == same
    assert through_a_pipe(events, path) == told


def essence(event):
    return {name: event.get(name) for name in ("kind", "time", "id", "field", "flag", "event", "message")}


# Not frame.number > 3: a read filter counts the packets that it leaves, so that all would be number 1 and none left.
READ_FILTERS = levels.few(["yapp", "not the first three", "frame.number < 60", "can.id != 0x8408000"],
                          ["not the first three", "can.id != 0x8408000"])


@levels.each_once
@pytest.mark.parametrize("read_filter", READ_FILTERS)
@pytest.mark.parametrize("form", levels.few(list(FORMS), ["pcapng", "sll2.pcap"]))
def test_a_read_filter_makes_nobody_invent(form, read_filter, folder):
    """Numbers shift, and it may know less: but what it tells is so, or is of what the filter took away."""
    path = written(folder, turns(), form)
    kept = [one for number, one in enumerate(turns(), 1) if not (
        read_filter.startswith("not") and one.time <= turns()[2].time or read_filter == "frame.number < 60" and number >= 60 or
        read_filter.startswith("can") and one.can_id == 0x8408000)]
    read_filter = f"frame.time_epoch > {turns()[2].time / 1e6:.6f}" if read_filter.startswith("not") else read_filter
    (folder / "left").mkdir()
    left = [essence(one) for one in events(written(folder / "left", kept, form))]
    full = [essence(one) for one in events(path)]
    found = [essence(one) for one in events(path, "-2", "-R", read_filter, check=False)]
    assert full and left and found
    for one in (*left, *full, *found):  # which of its frames says that a message without its Start is incomplete is not the point
        one["time"] = None if one["kind"] == "incomplete" else one["time"]
    # A message that the filter cut may be said to be cut off by the end of the capture.
    assert [one for one in found if one not in full and one not in left and one["kind"] != "unfinished"] == []


@pytest.fixture
def blf(folder):
    can = pytest.importorskip("can")
    path = folder / "buses.blf"
    with can.BLFWriter(str(path)) as writer:
        for one in turns():
            writer.on_message_received(can.Message(timestamp=one.time / 1e6, channel=one.bus, arbitration_id=one.can_id,
                                                   is_extended_id=True, data=one.data))
    return path


def test_blf_tells_no_buses(blf, folder):
    """What is told is so, and that the buses are not known is said."""
    full = [{**essence(one), "time": None} for one in events(written(folder, turns(), "pcapng"))]
    for options in levels.size([(), ("-2", "-R", "yapp")], [(), *SECOND_LOOKS, ("-2", "-R", "yapp")]):
        done = tshark.run("-q", "-r", blf, *options, "-z", "yapp,events,json", "-z", "yapp,check,reboot=9,fault=9,incomplete=9",
                          check=False)
        found = [{**essence(json.loads(line)), "time": None} for line in done.stdout.splitlines() if line.startswith("{")]
        assert full and found and [one for one in found if one not in full] == [], options
        assert done.returncode == 21, options
    shown = "".join(info for _, info in listed(blf, "-2", check=False))
    assert "reboot" not in shown.lower()


def test_can_inside_ethernet_tells_no_buses(folder):
    """IEEE 1722 on two interfaces: which bus a frame was on is not known, and that is said."""
    path = folder / "inside.pcapng"
    path.write_bytes(interfaces(["eth0", "eth1"], linktype=1) + b"".join(
        packet(one.time, one.bus, flights.acf_can(can_generator.Frame(one.can_id, one.data))) for one in turns()))
    done = tshark.run("-q", "-r", path, "-z", "yapp,check,fault=9,incomplete=9", "-z", "yapp,events,json", check=False)
    assert done.returncode == 21 and "nothing tells the buses of 0x210 apart" in done.stdout + done.stderr
    assert '"reboot"' not in done.stdout


def test_an_interface_beside_can_is_a_bus():
    """CAN on can0 and, in IEEE 1722, on eth0: commands stop on can0 alone."""
    path = tshark.CAPTURES / "cases" / "c2_silence_masked.pcapng"
    done = tshark.run("-q", "-r", path, "-z", "yapp,check,json", check=False)
    failed = [line for line in map(json.loads, done.stdout.splitlines()) if not line["ok"]]
    assert done.returncode == 20 and [(row["rule"], row["bus"]) for row in failed] == [("silence=0", "can0")]


# What a file says of its packets ---------------------------------------------------------------------------------

CASES = tshark.CAPTURES / "cases"
TIMELESS = ",fault=0,crc=0,incomplete=0,reboot=0"  # rules that need no times


@levels.each_once
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two"])
@pytest.mark.parametrize("case", [("b1_custom_block", TIMELESS), ("b2_tsoffset", ""), ("b3_spb_two_interfaces", TIMELESS)],
                         ids=lambda case: case[0])
def test_the_bus_is_the_interface(case, passes):
    name, rules = case
    path = CASES / f"{name}.pcapng"
    rows = tshark.fields(path, ["yapp.bus", "frame.interface_name"], *passes, "-Y", "yapp")
    assert len(rows) >= 300 and [row for row in rows if row[0] != row[1]] == []
    assert tshark.run("-q", "-r", path, *passes, "-z", f"yapp,check{rules}").returncode == 0


def section(names, order):
    return capture_file.section(*(capture_file.interface(capture_file.SOCKETCAN, name, order=order) for name in names), order=order)


# Bodies of blocks that are no packets of a bus; Wireshark gives the first of them a frame number.
NUMBERED = [(9, b"__REALTIME_TIMESTAMP=1700000000000000\nMESSAGE=x\n"), (0xBAD, b"\0\0\1\0custom"), (0x40000BAD, b"\1\0\0\0")]
UNNUMBERED = [(4, bytes(4)), (5, bytes(12)), (0x80000001, b"local"), (0x777, b"")]


def test_every_block_that_has_a_frame_number(folder):
    """In sections of either byte order; the numbers are Wireshark's own."""
    rng, parts, expected = random.Random(38), [], []
    data = record(Placed(0, 0, 0x210 << 18 | 2 << 14, bytes(8)))
    for at, order in enumerate("<><"):
        names = [f"can{3 * at + number}" for number in range(3)]
        parts.append(section(names, order))
        for _ in range(60):
            if rng.random() < 0.5:
                kind, body = rng.choice(NUMBERED + UNNUMBERED)
                parts.append(capture_file.block(kind, body, order))
                expected += [""] if (kind, body) in NUMBERED else []
            kind, bus = rng.choice((6, 6, 3)), rng.randrange(3)
            parts.append(capture_file.packet(BEGIN, data, bus, order=order) if kind == 6 else
                         capture_file.block(3, struct.pack(order + "I", len(data)) + data, order))
            expected.append(names[0 if kind == 3 else bus])
    path = folder / "blocks.pcapng"
    path.write_bytes(b"".join(parts))
    for passes in [(), ("-2",)]:
        assert [row[0] for row in tshark.fields(path, ["yapp.bus"], *passes)] == expected


@pytest.mark.parametrize("names, linktype, shown", [
    (["any"], 276, ["any#3", "any#4"]),
    (["\x1ba", "a\x01"], 227, [r"\x1Ba", r"a\x01"]),
])
def test_two_buses_never_have_one_name(names, linktype, shown, folder):
    """The same in fields, in Info, in statistics and in the preference."""
    path = folder / "buses.pcapng"
    path.write_bytes(interfaces(names, linktype=linktype) + b"".join(
        packet(one.time, one.bus, record(one)) if linktype == 227 else packet(one.time, 0, sll2(one)) for one in turns()))
    rows = tshark.fields(path, ["yapp.bus", "yapp.source"], "-o", f"yapp.sources:{shown[1]}/0x210=motor:right")
    rows = [[text.replace("\\\\", "\\") for text in row] for row in rows]  # as tshark doubles it
    assert [row[0] for row in rows] == [shown[one.bus] for one in turns()]
    assert {tuple(row) for row in rows} == {(shown[0], f"{shown[0]} 0x210"), (shown[1], "right")}
    listed_rows, told = listed_and_told(path)
    assert {one["bus"] for one in told} == set(shown)
    assert all(f"({shown[one.bus]})" in info for one, (_, info) in zip(turns(), listed_rows))


def test_a_long_pipe_opens(folder):
    """Of more than Wireshark can rewind."""
    frames = [one._replace(time=one.time + at * 1_000_000) for at in range(40) for one in turns()]
    path, expected = written(folder, frames, "pcapng"), [f"can{one.bus}" for one in frames]
    assert path.stat().st_size > 160_000
    for passes in [(), ("-2",)]:  # of the file all is known
        assert [row[0] for row in tshark.fields(path, ["yapp.bus"], *passes)] == expected
    assert [source.split()[0] for source, _ in through_a_pipe(listed, path)] == expected
