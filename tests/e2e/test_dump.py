# SPDX-License-Identifier: GPL-2.0-or-later
"""Raw serial dumps: a .yapp file opens by its name, each frame and each range between frames is a record, nothing is
lost; and no file of others is taken.

YAPP_SEED chooses other random dumps.
"""
import gzip
import itertools
import os
import random
import struct
import subprocess

import pytest

import levels
import model
import stream_captures
import test_streams
import tshark
from other_reader import OTHER_READER
from stream_captures import EXPORTED_PDU, KNOWN, LEAST, Event, Oracle, Origin, Packet, frame, header

CAPTURES = tshark.CAPTURES
SEED = os.environ.get("YAPP_SEED", "1")
AS_DUMP = ["-X", "read_format:yapp_dump"]
LONGEST = 65536  # bytes between frames in one record
TAGS = 28  # bytes of an exported PDU in front of the record's own
FRAME = ["frame.len", "frame.cap_len", "frame.file_off", "frame.time_epoch", "frame.protocols"]
SAID = "yapp: not opened as a raw serial dump"


# The truth -------------------------------------------------------------------------------------------------------

TIMES = {ident: sum(size for _, size, _ in itertools.takewhile(lambda row: row[2] is not None, message[2]))
         for ident, message in model.MESSAGES.items() if message.has_clock}  # where the time stamp is in the payload


def stamp(event):
    """The controller's own time in nanoseconds, a double: exact up to 2^53, 104 days.  None without one."""
    if event.kind != "good" or event.ident not in TIMES or len(event.payload) < LEAST[event.ident]:
        return None
    at = TIMES[event.ident]
    nanoseconds = struct.unpack("<q", event.payload[at:at + 8])[0]
    return nanoseconds // 10**9 * 1e9 + nanoseconds % 10**9 if nanoseconds >= 0 else None


def records(data):
    """What a dump has to show: the events of its bytes as a whole, each with the time of the record."""
    events = []
    for event in Oracle(data).events(len(data), ended=True)[0]:
        for at in range(0, len(event.data), LONGEST if event.kind == "skipped" else len(event.data)):
            size = LONGEST if event.kind == "skipped" else len(event.data)
            events.append(Event(event.kind, event.data[at:at + size], event.start + at))
    times = [stamp(event) for event in events]
    line = Line(next((time for time in times if time is not None), None))
    for event, time in zip(events, times):
        now = line.now if time is None else line.go_on(event.ident, time)
        event.time = None if now is None else int(now)
    return events


class Line:
    """The time of a dump, which never goes back.  Each ID has clocks: that of a controller, a new one if it reboots."""

    def __init__(self, now):
        self.now, self.clocks, self.latest = now, {}, 0

    def go_on(self, ident, time):
        clocks = self.clocks.setdefault(ident, [])  # [the last stamp, how far the dump's time is ahead of it]
        clock = max((clock for clock in clocks if clock[0] <= time and time + clock[1] > self.now - 10**9),
                    key=lambda clock: clock[0], default=None)
        if clock is None:
            shares = 0 <= time + self.latest - self.now < 10**9
            clock = [time, self.latest if shares else self.now - time]
            clocks.append(clock)
        clock[0], self.latest = time, clock[1]
        self.now = max(self.now, time + clock[1])
        return self.now


def message(ident, nanoseconds, rng):
    """A known message with this time stamp."""
    payload = bytearray(rng.randbytes(KNOWN[ident]))
    if ident in TIMES:
        payload[TIMES[ident]:TIMES[ident] + 8] = struct.pack("<q", nanoseconds)
    return frame(ident, bytes(payload), rng.randrange(256))


def clocked(rng, count):
    """Bytes from a controller whose time stamps go on but for reboots, with all kinds of damage between them."""
    now, pieces = rng.randrange(10**12), []
    for _ in range(count):
        now = rng.randrange(10**9) if rng.random() < 0.1 else now + rng.randrange(10**8)
        pieces.append(message(rng.choice([*KNOWN]), now, rng))
        if rng.random() < 0.5:
            pieces.append(rng.choice(stream_captures.PIECES)(rng))
    return b"".join(pieces)


# What tshark shows -----------------------------------------------------------------------------------------------


def rows(path, *arguments):
    """The records, as dictionaries of what is there: {field: [values]}."""
    return list(test_streams.shown(path, "-o", "frame.show_file_off:TRUE", *arguments, also=FRAME).values())


def packets_of(events):
    """The record of each event, as a packet of its own, with the times between messages of one ID."""
    packets, previous = [], {}
    for number, event in enumerate(events, 1):
        packet = Packet(event.data, Origin(EXPORTED_PDU, 0, 0))
        packet.number, packet.events = number, [Event(event.kind, event.data, 0)]
        if event.kind == "good":
            if event.ident in previous and event.time is not None:
                packet.events[0].delta = event.time - previous[event.ident]
            previous[event.ident] = event.time
        packets.append(packet)
    return packets


def slack_of(events):
    """How many nanoseconds a double may miss: times count from the first one."""
    known = [event.time for event in events if event.time is not None]
    return max(abs(time - known[0]) for time in known) // 2**52 if known else 0


def is_time(text, event, slack):
    if event.time is None or text is None:
        return text is None and event.time is None
    seconds, nanoseconds = text.split(".")
    return abs(int(seconds) * 10**9 + int(nanoseconds) - event.time) <= 2 * slack


def rounded(packet, row, events):
    """The row, with a time between messages as it should be where it is right as far as Lua's pinfo goes, which counts
    the time since the first record in doubles: random time stamps are centuries apart."""
    slack = slack_of(events)
    deltas = [model.time_text(one.delta) for one in packet.events if one.delta is not None]
    shown = row.get("yapp.time_delta", [])
    if slack and len(deltas) == len(shown) and all(abs(float(a) - float(b)) < 2e-9 * slack for a, b in zip(deltas, shown)):
        return {**row, "yapp.time_delta": deltas}
    return row


def differences(events, shown, name, written=False):
    """Between the truth and the rows.  written: read from a pcapng file, which has times and no offsets of the dump."""
    problems = [] if len(events) == len(shown) else [f"{name}: {len(events)} records expected, {len(shown)} shown"]
    offset, slack = 0, slack_of(events)
    for event, packet, row in zip(events, packets_of(events), shown):
        assert event.start == offset and "_ws.lua.error" not in row
        offset += len(event.data)
        time = f"{event.time // 10**9}.{event.time % 10**9:09d}" if event.time is not None else None
        if is_time(row.get("frame.time_epoch", [None])[0], event, slack):
            row["frame.time_epoch"] = [time]
        wanted = {"frame.len": str(TAGS + len(event.data)), "frame.cap_len": str(TAGS + len(event.data)),
                  "frame.file_off": None if written else str(event.start), "frame.time_epoch": time}
        problems += [f"{name}, record {packet.number}: {field}: {value} expected, {row.get(field)} shown"
                     for field, value in wanted.items() if not (written and value is None) and
                     row.get(field, [None]) != [value]]
        problems += [f"{name}: {text}" for text in test_streams.Comparison(packet, rounded(packet, row, events), False).run()]
    return problems


WAYS = {"one pass": [], "-2": ["-2"], "-2 -Y": ["-2", "-Y", "yapp"], "-2 -R": ["-2", "-R", "yapp"], "written": []}


def assert_shown(path, folder, data, ways=WAYS):
    """A dump shows its records in every way to read it, or in these."""
    events = records(data)
    assert b"".join(event.data for event in events) == data
    for name in ways:
        read = path
        if name == "written":
            read = folder / "out.pcapng"
            tshark.run("-r", path, "-w", read)
        problems = differences(events, rows(read, *WAYS[name]), name, written=name == "written")
        assert not problems, f"{len(problems)}\n" + "\n".join(problems[:20])


def dump(folder, data, name="run.yapp"):
    path = folder / name
    path.write_bytes(data)
    return path


# Random dumps ----------------------------------------------------------------------------------------------------

ENDS = {
    "a frame": lambda rng: stream_captures.good(rng),
    "a cut frame": lambda rng: stream_captures.good(rng)[:-rng.randrange(1, 5)],
    "a cut header": lambda rng: stream_captures.good(rng)[:rng.randrange(1, 12)],
    "a claim": lambda rng: header(0x333, 65535) + stream_captures.noise(rng),
    "text": lambda rng: b"> reboot\r\n",
    "Y": lambda rng: b"Y",
}


STARTS = {
    "a frame": lambda rng: message(0x210, 5, rng),
    "the rest of a frame": lambda rng: message(0x210, 5, rng)[14:],
    "text": lambda rng: b"\r\nTaurus 1.2\r\n> ",
}


@levels.each_once
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("start, end", [*zip([*STARTS] * 2, ENDS), *zip([*STARTS][1:] + [*STARTS], ENDS)])
def test_random_dumps(start, end, way, folder):
    rng = random.Random(f"{SEED}, {start}, {end}")
    data = STARTS[start](rng) + stream_captures.stream(rng, b"") + clocked(rng, 30) + ENDS[end](rng)
    assert_shown(dump(folder, data), folder, data, [way])


# Times -----------------------------------------------------------------------------------------------------------

def times(path, *arguments):
    return [row.get("frame.time_epoch", [""])[0] for row in rows(path, *arguments)]


def test_ids_of_the_preferences(folder):
    """The time is that of a message whose ID is no default."""
    data = message(0x210, 9, random.Random(SEED))
    path = dump(folder, frame(0x211, data[12:-4]))
    assert times(path) == [""]
    assert times(path, "-o", "yapp.motor_ids:0x211") == ["0.000000009"]


def test_two_controllers_with_one_id(folder):
    """Their clocks alternate: the answer says so, and invents no silence."""
    rng, tenth = random.Random(SEED), 10**8
    data = b"".join(message(0x210, begin + at * tenth, rng) for at in range(50) for begin in (1000 * 10**9, 50 * 10**9))
    done = tshark.run("-r", dump(folder, data), "-q", "-z", "yapp,check,silence=0", check=False)
    assert done.returncode == 21 and "what came before its messages is not known" in done.stdout
    seconds = [float(time) for time in times(dump(folder, data))]
    assert max(later - earlier for earlier, later in itertools.pairwise(seconds)) < 0.2


# Names and other ways in -----------------------------------------------------------------------------------------

def some(seed=SEED):
    rng = random.Random(seed)
    return b"\r\n> " + clocked(rng, 20)


@levels.by_route
@pytest.mark.parametrize("name", levels.few(["run", "run.bin", "run.log", "run.yapp.bak", "-"], ["run.bin", "-"]))
def test_any_other_name(name, folder):
    """It is not taken unless the user says what it is."""
    data = some()
    path = dump(folder, data, name if name != "-" else "piped")
    if name == "-":
        with open(path, "rb") as stdin:
            done = tshark.run("-r", "-", stdin=stdin, check=False)
    else:
        done = tshark.run("-r", path, check=False)
    assert done.returncode and not done.stdout and SAID not in done.stderr
    for passes in levels.size([["-2"]], [[], ["-2"]]):
        assert not differences(records(data), rows(path, *AS_DUMP, *passes), name)


def test_pipes(folder):
    data = some() + b"text " * 100000 + some()
    path = dump(folder, data)
    arguments = [*AS_DUMP, "-r", "-", "-T", "fields", "-e", "frame.len"]
    with subprocess.Popen(["cat", path], stdout=subprocess.PIPE) as cat:
        piped = tshark.run(*arguments, stdin=cat.stdout)
    assert piped.stdout.split() == [str(TAGS + len(event.data)) for event in records(data)]


@pytest.mark.parametrize("name", ["run.yapp.gz", "run.yapp"])
def test_compressed(name, folder):
    data = some()
    assert_shown(dump(folder, gzip.compress(data), name), folder, data, levels.size(["-2"], WAYS))


# Files of others -------------------------------------------------------------------------------------------------

ONE = frame(0x301, b"payload")
BAD = ONE[:-1] + bytes([ONE[-1] ^ 1])

# Files without a frame: no kind of name makes a dump of them.
NO_DUMPS = {
    "empty": b"",
    "noise": random.Random(7).randbytes(100000),
    "claims": header(0x210, 32) + header(0x333, 65535) * 2000,
    "bad frames": BAD * 100,
    "asc": b"date Tue Nov 14 22:13:20 2023\nbase hex  timestamps absolute\n" +
           b"   0.000130 1  8404000x       Rx   d 8 BB BE 6F C7 20 00 00 00\n" * 10,
    "candump screen": (CAPTURES / "candump/candump_screen_absolute.txt").read_bytes(),
}

# Files of others in which YAPP frames are, as they are on the line.
WITH_FRAMES = {
    "pcap": (CAPTURES / "serial/document_uart.pcap").read_bytes(),
    "pcapng": (CAPTURES / "can/two_interfaces.pcapng").read_bytes(),
    "tar": b"run.pcap".ljust(512, b"\0") + (CAPTURES / "serial/document_uart.pcap").read_bytes(),
    "other logger": b"LOG1" + (b"\x00\x01\x02\x03" + ONE) * 100,
    "dump": ONE * 10,
}
OPENED = ["asc", "candump screen", "pcap", "pcapng"]  # by other readers


def outcome(path, *arguments, plugin=True):
    done = tshark.run(*arguments, "-r", path, plugin=plugin, check=False)
    return (done.returncode, done.stdout), done.stderr


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("extension", levels.few(["", ".bin", ".yapp"], [".bin", ".yapp"]))
@pytest.mark.parametrize("name", levels.few([*NO_DUMPS, *WITH_FRAMES], ["noise", "claims", "bad frames", "asc", "other logger", "dump"]))
def test_files_of_others(name, extension, folder):
    """As if the plugin were not there; the reason is told where the name or the user says that it is a dump."""
    path = dump(folder, {**NO_DUMPS, **WITH_FRAMES}[name], "file" + extension)
    if extension == ".yapp":
        if name in WITH_FRAMES:
            return
        done, errors = outcome(path, *AS_DUMP)
        assert done[0] and not done[1] and SAID in errors
    done, errors = outcome(path)
    assert (SAID in errors) == (extension == ".yapp") and "yapp_dump" not in errors
    if extension == ".yapp":
        assert ("the file is empty" if name == "empty" else "no YAPP frame with a good CRC") in errors
    if name in OPENED:
        assert done[0] == 0 and "Motor Data" in done[1]
    else:
        assert done == outcome(path, plugin=False)[0]
        said = [line for line in errors.splitlines() if not line.startswith("Running as user")]
        assert done[1] or said or name == "empty" and done[0] == 0  # of which tshark says nothing


@levels.by_route
@levels.each_once
@pytest.mark.parametrize("content", [ONE * 10, (CAPTURES / "candump/candump_log_two_buses.log").read_bytes()], ids=["dump", "candump"])
@pytest.mark.parametrize("kind", ["r", "rs"])
def test_the_reader_of_another_plugin_keeps_its_files(kind, content, folder):
    (folder / "other.lua").write_text(OTHER_READER % kind)
    path = dump(folder, b"OTHER\n" + content, "file")
    done = tshark.run(*tshark.load(folder / "other.lua"), "-r", path, "-T", "fields", "-e", "frame.len")
    lengths = done.stdout.split()
    assert len(lengths) == -(-len(content) // 23) and set(lengths[:-1]) == {"23"}
