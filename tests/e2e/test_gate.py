# SPDX-License-Identifier: GPL-2.0-or-later
"""The CI recipe in a real shell, on what it must let pass and on what it must stop; and how statistics end otherwise."""
import json
import os
import re
import shlex
import shutil
import subprocess

import pytest

import levels
import make
import model
import stream_captures
import tshark
from can_generator import Frame, Sent
from flights import block, option, pad, struct

RECIPE = next(line.strip() for line in (tshark.ROOT / "docs/rules.md").read_text().splitlines()
              if line.startswith("    tshark -q -r run.pcapng"))
MOTOR, OTHER = 0x210, 0x310
BEGIN = 1_700_000_000_000_000_000


def motor_payload(index, faults=0, mode=1, state=1):
    return struct.pack("<6HBBIIqBB", *[32765] * 6, 70, mode, 0x40010000, faults, index * 100_000_000, state, 80)


def flight(ident=MOTOR, seq=0, count=30, spoil=None):
    """Frames of Motor Data, ten a second: (time, frame).  spoil(index, frames, payload) changes those of a message."""
    placed = []
    for index in range(count):
        sent = Sent(ident, 0, seq, motor_payload(index))
        frames = spoil(index, sent) if spoil else sent.frames()
        placed += [(BEGIN + index * 100_000_000 + place * 300_000, frame) for place, frame in enumerate(frames)]
        seq = (seq + 1) % 256 if seq else 0
    return placed


def only_at(wanted, change):
    return lambda index, sent: change(sent) if index == wanted else sent.frames()


def with_fault(sent):
    return Sent(sent.msg, 0, sent.seq, motor_payload(9, faults=0x10000)).frames()


def command(key, at):
    return BEGIN + at, Frame(0, bytes([1, key, 1, 0xFD, 0x7F, 0xFD, 0x7F]))


def cut_in(place):
    """The snap length left two bytes of one frame of a message with a fault."""
    def change(sent):
        frames = with_fault(sent)
        frames[place].captured = 2
        return frames
    return change


def pcapng(placed, buses=("can0",)):
    blocks = [block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))]
    for name in buses:
        options = option(2, name.encode()) + option(9, b"\x09") + option(0, b"")
        blocks.append(block(1, struct.pack("<HHI", 227, 0, 0) + options))
    for at, frame in placed:
        record = frame.record()
        kept = record if frame.captured is None else record[:8 + frame.captured]
        head = struct.pack("<IIIII", frame.bus, at >> 32, at & 0xFFFFFFFF, len(kept), len(record))
        blocks.append(block(6, head + pad(kept)))
    return b"".join(blocks)


CLEAN = flight()


def installed(folder, change=None):
    """A home with the plugin in its plugin folder, and what a change makes of it."""
    plugin = tshark.install_plugin(folder / "home" / tshark.PERSONAL_FOLDER / "yapp")
    if change:
        change(plugin)
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o777 if path.is_dir() else 0o666)
    return folder / "home"


def shell(folder, command, home):
    """Runs a line in bash as a CI job would; returns the exit code, standard output and standard error."""
    environment = {**os.environ, "HOME": str(home), "LC_ALL": "C.UTF-8"}
    environment.pop("XDG_CONFIG_HOME", None)
    done = subprocess.run(["bash", "-e", "-c", command], cwd=folder, env=environment, capture_output=True, text=True,
                          timeout=120, stdin=subprocess.DEVNULL, **tshark._user())
    errors = [line for line in done.stderr.splitlines() if not line.startswith("Running as user")]
    return done.returncode, done.stdout, "\n".join(errors)


def gate(folder, data, command=RECIPE, change=None, plugin=True):
    (folder / "run.pcapng").write_bytes(data)
    if plugin:
        home = installed(folder, change)
    else:
        home = folder / "home"
        home.mkdir(mode=0o777)
    return shell(folder, command, home)


def break_catalogue(plugin):
    (plugin / "taurus_fields.lua").write_text("return {")


def break_one_message(plugin):
    path = plugin / "taurus_fields.lua"
    path.write_text(path.read_text().replace('size = 17,',
                                             'size = 18,'))


def lose_module(plugin):
    path = plugin / "yapp.lua"
    path.write_text(path.read_text().replace('module("yapp.message.types"', 'module("yapp.message.lost"'))


# Random flights have every kind of event: see test_statistics.py.
CASES = {
    "clean": (pcapng(CLEAN), 0),
    "fault": (pcapng(flight(spoil=only_at(9, with_fault))), 20),
    "cut at the end": (pcapng(CLEAN[:-2]), 20),
    "an End that the capture cut": (pcapng(flight(spoil=only_at(9, cut_in(4)))), 20),
    "a Command that the capture cut": (pcapng([*CLEAN, (CLEAN[-1][0], Frame(0, bytes(7), captured=3))]), 20),
    "other IDs": (pcapng(flight(OTHER)), 20),
    "other IDs that are numbered": (pcapng(flight(OTHER, seq=1)), 21),  # nothing claims the frames
    "an ignored command": (pcapng([*CLEAN, command(0x33, 2_910_000_000)]), 20),
    "a command": (pcapng([*CLEAN, command(0xA5, 2_910_000_000)]), 0),
    "a silence to the end": (pcapng([*CLEAN, (BEGIN + 4_000_000_000, Frame(0x18FEF100, bytes(8)))]), 20),
    "empty capture": (pcapng([]), 21),
    "nothing of ours": (pcapng([(BEGIN, Frame(0x18FEF100, bytes(8)))]), 21),
}


@pytest.mark.parametrize("name", CASES)
def test_recipe(folder, name):
    data, code = CASES[name]
    returned, output, errors = gate(folder, data)
    assert (returned, errors) == (code, ""), output
    assert "unknown=0" in output and output.count("\n") >= 5


# Without a catalogue all messages are unknown, which the rules forbid.
@pytest.mark.parametrize("change, code", [(break_one_message, 21), (break_catalogue, 20)])
def test_broken_catalogue(folder, change, code):
    returned, _, errors = gate(folder, pcapng(CLEAN), change=change)
    assert returned == code
    assert "taurus_fields.lua" in errors and "the catalogue did not load whole" in errors


def test_no_whole_plugin(folder):
    assert gate(folder, pcapng(CLEAN), plugin=False)[0] == 1
    shutil.rmtree(folder / "home")
    assert gate(folder, pcapng(CLEAN), change=lose_module)[0] == 1


def test_a_read_filter_where_several_buses_have_one_id(folder):
    """The first pass, which has no fields, then takes both for one source, and what came before is not known."""
    placed = []
    for index in range(6):
        for bus in (0, 1):
            fault = 0x10000 if (index, bus) == (3, 0) else 0
            for ident, payload in ((MOTOR, motor_payload(index, fault)), (0x200, bytes(17))):  # one CAN FD frame each
                (can_id, data), = make.can_frames({"id": ident, "payload": payload, "seq": 0, "ctl": 0,
                                                   "wrong_crc": False}, True)
                placed.append((BEGIN + index * 100_000_000, Frame(can_id, data, fd=True, bus=bus)))
    (folder / "run.pcapng").write_bytes(pcapng(placed, ("can0", "can1")))
    for passes, code in (((), 20), (("-2",), 20), (("-2", "-R", "yapp.id == 0x210"), 21)):
        done = tshark.run(*passes, "-q", "-r", folder / "run.pcapng", "-z", "yapp,check,fault=0", check=False)
        assert done.returncode == code, (passes, done.stdout)
    assert "what came before its messages is not known" in done.stdout
    for what, code in (("faults", 21), ("events", 21), ("summary", 21), ("csv,-,motor", 0)):
        done = tshark.run("-2", "-R", "yapp.id == 0x210", "-q", "-r", folder / "run.pcapng", "-z", f"yapp,{what}", check=False)
        said = "nothing tells the buses of 0x210 apart"
        assert (done.returncode, said in done.stderr) == (code, code == 21), what
        assert (said in done.stdout) == (code == 21), what


def test_a_name_is_that_of_its_own_interface(folder):
    """CAN has the name of the only CAN interface; what comes by UDP that of its sender."""
    datagram = stream_captures.udp(stream_captures.Packet(stream_captures.frame(MOTOR, motor_payload(1)),
                                                          stream_captures.Origin(stream_captures.ETHERNET, 0, 0)))
    command = Frame(0, bytes(7)).record()
    blocks = [block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))]
    blocks += [block(1, struct.pack("<HHI", linktype, 0, 0) + option(2, name) + option(9, b"\x09") + option(0, b""))
               for linktype, name in ((1, b"eth0"), (227, b"can0"))]
    blocks += [packet(0, 0, datagram), packet(1, 1, command)]
    (folder / "run.pcapng").write_bytes(b"".join(blocks))
    assert tshark.fields(folder / "run.pcapng", ["yapp.id", "yapp.bus"]) == [
        ["0x00000210", "192.0.2.1"], ["0x00000000", "can0"]]


def packet(interface, index, data):
    at = BEGIN + index * 100_000_000
    return block(6, struct.pack("<IIIII", interface, at >> 32, at & 0xFFFFFFFF, len(data), len(data)) + pad(data))


def test_truncated_file(folder):
    returned, output, errors = gate(folder, pcapng(CLEAN)[:-20])
    assert returned == 20 and "cut short" in errors  # its last message is not whole
    assert "unknown=0" in output  # the rules are printed all the same


STREAM = """link {link}
let motor = 00*32
> [210 $motor]
> 59 50 02 00 10 02 00 00 20 00 00 00 FD 7F
> FD 7F FD 7F FD 7F
"""


@levels.each_once
@pytest.mark.parametrize("passes", ["", " -2"], ids=["one pass", "two"])
@pytest.mark.parametrize("link", ["pdu", "tcp", "udp"])
def test_a_stream_that_ends_within_a_frame(folder, home, link, passes):
    data = make.pcap(make.Source(STREAM.format(link=link)))
    returned, output, _ = z(folder, "events,json", "check,incomplete=0", data=data, command="tshark -q -r run.pcapng" + passes)
    events = [json.loads(line) for line in output.splitlines() if line.startswith("{")]
    found = [(one["kind"], one["frame"], one["id"], one["message"]) for one in events]
    assert found == [("unfinished", 3, 0x210, "motor")]
    assert returned == 20 and z(folder, "check,incomplete=1", data=data)[0] == 0


def test_two_passes_and_a_capture_that_is_written(folder):
    assert gate(folder, CASES["fault"][0], RECIPE + " -2")[0] == 20
    returned, _, _ = shell(folder, RECIPE.replace("-q", "-w out.pcapng"), folder / "home")
    assert returned == 20
    frames = shell(folder, "tshark -r out.pcapng -T fields -e frame.number", folder / "home")[1]
    assert len(frames.split()) == 150


# No false all-clear --------------------------------------------------------------------------------------------------

CASES_FOLDER = tshark.CAPTURES / "cases"
# The capture; what a check of it asks for; its exit code; the rules that fail.
JUDGED = [
    ("g0_clean.pcapng", "", 0, set()),
    ("g0_clean.pcapng", ",motor.rate=9..11", 0, set()),
    ("g1_clock_back_motor_dead.pcapng", "", 20, {"clock", "silence"}),
    ("g2_seq_half_lost.pcapng", "", 20, {"missing"}),
    ("g3_dropcount.txt", "", 20, {"dropped"}),
    ("g4_isb_ifdrop.pcapng", "", 20, {"dropped"}),
    ("g4_epb_dropcount.pcapng", "", 20, {"dropped"}),
    ("g5_two_escs_one_id.pcapng", ",motor.rate=9..11", 20, {"motor.rate"}),
    ("g6_controller_swap.pcapng", "", 20, {"jump"}),
    ("g8_udp_first_bad.pcap", "", 20, {"crc"}),
    ("g13_no_times_motor_dead.txt", ",silence=0,motor.gap=0.3", 21, set()),
    ("g13_spb_no_times.pcapng", ",silence=0,motor.gap=0.3", 21, set()),
]


@levels.each_once
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two passes"])
@pytest.mark.parametrize("row", JUDGED, ids=lambda row: row[0].partition("_")[0] + row[1])
def test_what_the_gate_let_through(row, passes):
    """Captures that passed a gate of 2.1, but for the clean one."""
    name, rules, code, failed = row
    done = tshark.run(*passes, "-q", "-r", CASES_FOLDER / name, "-z", "yapp,events,json", "-z", f"yapp,check,json{rules}", check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    found = {line["rule"].split("=")[0] for line in lines if line.get("ok") is False}
    assert (done.returncode, found) == (code, failed), done.stdout
    assert [line["rule"] for line in lines if "rule" in line]
    kinds = {line["kind"] for line in lines if "kind" in line}
    assert failed - {"motor.rate"} <= kinds


def test_a_damaged_line_of_asc(tmp_path):
    """It may have been a message: an event, and no all-clear."""
    text = (tshark.CAPTURES / "other/motor.asc").read_text(encoding="utf-8")
    frames = [line for line in text.splitlines(keepends=True) if " d " in line]
    for path, content, dropped in ((tmp_path / "good.asc", text, 0), (tmp_path / "cut.asc", text.replace(frames[2], frames[2][:-6] + "\n"), 1)):
        path.write_text(content, encoding="utf-8")
        done = tshark.run("-q", "-r", path, "-z", "yapp,events,json", "-z", "yapp,check,json,dropped=0", check=False)
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        assert sum(row.get("kind") == "dropped" for row in rows) == dropped
        assert [row["seen"] for row in rows if row.get("rule") == "dropped=0"] == [dropped]
        assert ("not understood, counts as a lost packet" in done.stderr, done.returncode) == (dropped == 1, 20 * dropped)


def controllers(messages, count=20, seq=0):
    """(bus, ID, payload of the message of an index) each, ten a second."""
    placed = []
    for order, (bus, ident, payload) in enumerate(messages):
        for index in range(count):
            for place, frame in enumerate(Sent(ident, 0, (seq + index) % 256 if seq else 0, payload(index)).frames()):
                frame.bus = bus
                placed.append((BEGIN + index * 100_000_000 + order * 3_000_000 + place * 300_000, frame))
    return pcapng(sorted(placed, key=lambda one: one[0]), ("can0", "can1"))


def overheated(index):
    return motor_payload(index, faults=0x10000 if index > 5 else 0)


def health_payload(index):
    return struct.pack("<q", index * 100_000_000) + bytes(9)


EIGHT = [(bus, 0x210 + number, overheated if (bus, number) == (1, 3) else motor_payload)
         for bus in (0, 1) for number in range(4)]


def advice(text):
    """The preferences that a text says to try."""
    return shlex.split(re.search(r"\. Try (.*)", text)[1])


def undecoded_faults(*arguments):
    """What faults prints of a capture whose sources are not all decoded: their number is unknown, the exit code 21."""
    done = tshark.run("-q", *arguments, "-z", "yapp,faults", check=False)
    assert done.returncode == 21 and re.match(r"YAPP faults: UNKNOWN, \d+ of \d+ sources? not decoded, 0 in what was decoded\n", done.stdout)
    return done.stdout.splitlines()[1:]


@pytest.mark.parametrize("seq", [0, 7], ids=["not numbered", "numbered"])
def test_eight_controllers_without_a_preference(folder, seq):
    """Every answer says that six of them were not decoded; the preference that it suggests finds the fault."""
    (folder / "run.pcapng").write_bytes(controllers(EIGHT, seq=seq))
    text = "120 messages were not decoded: can0 0x211, 0x212, 0x213, can1 0x211, 0x212, 0x213 " \
        "(32 bytes each, the size of Motor Data). Try -o yapp.motor_ids:0x210-0x213"
    taps = [argument for what in model.IN_TEXT for argument in ("-z", f"yapp,{what}")]
    for passes in (), ("-2",):
        said = tshark.run(*passes, "-q", "-r", folder / "run.pcapng", *taps, check=False).stdout.splitlines()
        assert "YAPP faults: UNKNOWN, 6 of 8 sources not decoded, 0 in what was decoded" in said
        assert [following for line, following in zip(said, said[1:]) if line.startswith("YAPP")] == [text] * len(model.IN_TEXT)
        for what in model.ON_STDERR if not passes and not seq else model.ON_STDERR[:1]:
            done = tshark.run(*passes, "-q", "-r", folder / "run.pcapng", "-z", f"yapp,{what}", check=False)
            assert f"yapp: {text}\n" in done.stderr and done.returncode == (21 if what.startswith("fault") else 0), what
    assert tshark.run("-q", "-r", folder / "run.pcapng", "-z", "yapp,check", check=False).returncode == 20
    done = tshark.run(*advice(text), "-q", "-r", folder / "run.pcapng", "-z", "yapp,faults", "-z", "yapp,check,unknown=0")
    assert "motor_overcurrent" in done.stdout and "not decoded" not in done.stdout


def test_a_firmware_that_appended_bytes(folder):
    """The known part is decoded, a fault in it is found; that there is more is said."""
    def grown(index, sent):
        return Sent(sent.msg, 0, sent.seq, overheated(index) + b"more").frames()
    (folder / "run.pcapng").write_bytes(pcapng(flight(spoil=grown)))
    text = "30 messages were decoded in part: can0 0x210 (36 bytes each, Motor Data has 32)"
    done = tshark.run("-q", "-r", folder / "run.pcapng", "-z", "yapp,faults", "-z", "yapp,csv,-,motor")
    assert re.search(rf"^YAPP faults: 1\n{re.escape(text)}\n(.*\n)+.*motor_overcurrent  raised", done.stdout, re.M)
    assert f"yapp: {text}\n" in done.stderr and done.stdout.count(",can0,,528,") == 30
    done = tshark.run("-q", "-r", folder / "run.pcapng", "-z", "yapp,check,json", "-z", "yapp,events,json", check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert {line["rule"] for line in lines if line.get("ok") is False} == {"fault=0", "unknown=0"} and done.returncode == 20
    (one,) = [line for line in lines if line.get("kind") == "unknown"]
    assert (one["frame"], one["message"], one["size"], one["count"], one["like"]) == (6, "motor", 36, 30, None)


def command_payload(index):
    return bytes([1, 0xA5 if index % 2 else 0x5A, 1, index, 0x7F, 0xFD, 0x7F])


def test_single_frames_of_an_unknown_id(folder):
    """Commands of an ID that is not listed look like Commands: said, with the preference.  Other programs' frames do not."""
    placed = list(CLEAN)
    for index in range(20):
        command, at = command_payload(index), BEGIN + 50_000_000 + index * 100_000_000
        other = bytearray(command)
        other[index % 3] = 9
        placed += [(at, Frame(0x005 << 18, command, bus=1)), (at + 300_000, Frame(0x006 << 18, bytes(other), bus=1))]
    (folder / "run.pcapng").write_bytes(pcapng(sorted(placed, key=lambda one: one[0]), ("can0", "can1")))
    text = "20 messages were not decoded: can1 0x5 (7 bytes each, the size of Command). Try -o yapp.command_ids:0x0,0x5"
    for passes in (), ("-2",):
        assert undecoded_faults(*passes, "-r", folder / "run.pcapng") == [text]
    assert tshark.run("-q", "-r", folder / "run.pcapng", "-z", "yapp,check", check=False).returncode == 20
    done = tshark.run(*advice(text), "-q", "-r", folder / "run.pcapng", "-z", "yapp,check,unknown=0,command.count=20")
    assert "not decoded" not in done.stdout


@pytest.mark.parametrize("payload", [overheated, command_payload])
def test_a_yapp_ctl_other_than_0(folder, payload):
    """The vendor plans to use it: such messages are not dissected, but said.  The preference decodes them."""
    size = len(payload(0))
    ident, title = (0x210, "Motor Data") if size == 32 else (0, "Command")
    placed = list(CLEAN)
    for index in range(20):
        at = BEGIN + 40_000_000 + index * 100_000_000
        frames = Sent(ident, 1, index, payload(index)).frames() if size > 8 else [Frame(ident << 18 | 1 << 8 | index, payload(index))]
        for place, frame in enumerate(frames):
            frame.bus = 1
            placed.append((at + place * 300_000, frame))
    (folder / "run.pcapng").write_bytes(pcapng(sorted(placed, key=lambda one: one[0]), ("can0", "can1")))
    text = f"20 messages were not decoded: can1 {ident:#x} ({size} bytes each, {title} with a YAPP CTL other than 0, " \
        "see yapp.all_extended)"
    for passes in (), ("-2",):
        assert undecoded_faults(*passes, "-r", folder / "run.pcapng") == [text]
    done = tshark.run("-o", "yapp.all_extended:TRUE", "-q", "-r", folder / "run.pcapng", "-z", "yapp,faults")
    assert "not decoded" not in done.stdout and ("motor_overcurrent" in done.stdout) == (payload is overheated)


def test_a_single_frame_of_another_size(folder):
    """A firmware that appended a byte to Command: not dissected, but said.  Other frames of its ID are no message."""
    placed = list(CLEAN)
    for index in range(20):
        at = BEGIN + 40_000_000 + index * 100_000_000
        placed.append((at, Frame(index, command_payload(index) + b"x", bus=1)))
        placed.append((at + 300_000, Frame(index, bytes(8), kind="remote", bus=1)))
        placed.append((at + 600_000, Frame(index, bytes([index % 2, index, 2, 0, 0, 0, 0, 0]), bus=1)))
        placed.append((at + 900_000, Frame(index, command_payload(index)[:6], bus=1)))
    (folder / "run.pcapng").write_bytes(pcapng(sorted(placed, key=lambda one: one[0]), ("can0", "can1")))
    titles = [title for _, title, _ in (one for one in model.MESSAGES.values() if one.size == 8)]
    about = f"the size of {' and of '.join(titles)}" if titles else "Command has 7"
    for passes in (), ("-2",):
        (line,) = undecoded_faults(*passes, "-r", folder / "run.pcapng")
        assert line.partition(")")[0] == f"20 messages were not decoded: can1 0x0 (8 bytes each, {about}"


@pytest.mark.parametrize("option", [("-o", "yapp.all_extended:TRUE"), ("-d", "can.subdissector,yapp_all")])
def test_single_frames_of_an_unknown_id_where_all_frames_are_yapp(folder, option):
    """They are shown as bytes, so they count as not decoded: from the first packet on, though nothing tells its CAN id."""
    frames = [Frame(1 << 18 | index, command_payload(1)) for index in range(3)] + Sent(MOTOR, 0, 1, motor_payload(1)).frames()
    (folder / "run").write_text("".join(f"(1700000000.{index:06d}) can0 {one.can_id:08X}#{one.data.hex().upper()}\n"
                                        for index, one in enumerate(frames)))
    (folder / "run.pcapng").write_bytes(pcapng([(BEGIN + index, one) for index, one in enumerate(frames)], ("can0",)))
    for name in ("run", "run.pcapng"):
        (line,) = undecoded_faults("-r", folder / name, *option)
        assert line.startswith("3 messages were not decoded: can0 0x1 (7 bytes each, the size of Command)")


def test_remote_frames_beside_data_of_zeros(folder):
    """Without a tree or a column only the CAN header tells remote frames, which captures give zeros, from data of zeros."""
    def payload(index):
        return motor_payload(index)[:8] + bytes(8) + motor_payload(index)[16:]

    placed = flight(count=300, spoil=lambda index, sent: Sent(sent.msg, 0, sent.seq, payload(index)).frames())
    for index in range(300):
        at = BEGIN + index * 100_000_000 + 400_000
        placed += [(at, Frame(MOTOR << 18 | 2 << 14, bytes(8), kind="remote")), (at, Frame(0, bytes(7), kind="remote"))]
    health = Sent(0x200, 0, 0, health_payload(1)).frames(fd=True, chunk=16)  # CAN FD has no flag for remote frames
    placed += [(BEGIN + 900_000 + at, frame) for at, frame in enumerate(health)]
    (folder / "run.pcapng").write_bytes(pcapng(sorted(placed, key=lambda one: one[0]), ("can0",)))
    rows = tshark.run("-q", "-r", folder / "run.pcapng", "-z", "yapp,csv,-,motor").stdout.splitlines()
    assert len(rows) == 301 and tshark.run("-q", "-r", folder / "run.pcapng", "-z", "yapp,csv,-,command").stdout.count("\n") == 1
    for output in "-q", "-V":
        lines = tshark.run(output, "-r", folder / "run.pcapng", "-z", "yapp,events,json").stdout.splitlines()
        events = [json.loads(line) for line in lines if line.startswith('{"kind"')]
        assert [(one["kind"], one["id"]) for one in events] == [("silence", 0x200)]  # of the one message of Health
    for capture in folder / "run.pcapng", tshark.ROOT / "test_captures/can/remote_frames.pcap":
        assert tshark.run("-q", "-r", capture, "-z", "yapp,check,incomplete=0,crc=0,invalid=0").returncode == 0


def test_what_no_message_is_found_in(folder):
    """It says what was there, and what to look at."""
    foreign = [(BEGIN + index, Frame(0x18FEF100, bytes(8))) for index in range(120)]
    standard = [(BEGIN + index, Frame(0x123, bytes(8), kind="standard")) for index in range(3)]
    extended = "no YAPP message found; 120 extended CAN frames were not dissected: see yapp.motor_ids, yapp.all_extended"
    for placed, text in ((foreign, extended), (flight(OTHER, seq=1, count=24), extended),
                         (standard, "no YAPP message found in 3 packets: see yapp.user_dlt"), ([], "no YAPP message found: the capture has no packets, or -R removed all of them")):
        (folder / "run.pcapng").write_bytes(pcapng(placed))
        for passes in (), ("-2",):
            done = tshark.run(*passes, "-q", "-r", folder / "run.pcapng", "-z", "yapp,summary", "-z", "yapp,faults,json", "-z",
                              "yapp,check", check=False)
            assert (done.returncode, done.stdout.splitlines()[1][:len(text)]) == (21, text)
            assert re.search(f"NOT JUDGED +fault=0 +{re.escape(text)}", done.stdout) and f"yapp: {text}" in done.stderr


def test_a_display_filter_narrows_no_statistic(folder):
    for options, is_said in (([], False), (["-Y", "yapp"], True), (["-Yyapp"], True), (["-qY", "yapp"], True),
                               (["-n2Yyapp"], True), (["-rY.pcap"], False)):
        done = tshark.run("-q", *options, "-r", CASES_FOLDER / "g0_clean.pcapng", "-z", "yapp,summary", "-z",
                          "yapp,faults,filter=yapp")
        assert [line.startswith("-Y does not narrow") for line in done.stdout.splitlines()].count(True) == is_said


# The other ends ------------------------------------------------------------------------------------------------------

def z(folder, *arguments, data=None, home=None, command="tshark -q -r run.pcapng"):
    (folder / "run.pcapng").write_bytes(pcapng(CLEAN) if data is None else data)
    taps = " ".join(f"-z 'yapp,{argument}'" for argument in arguments)
    return shell(folder, f"{command} {taps}", home or folder / "home")


@pytest.fixture
def home(folder):
    return installed(folder)


def test_what_z_says(folder, home):
    _, output, errors = shell(folder, "tshark -z help", home)
    listed = [line.strip() for line in (output + errors).splitlines() if "yapp," in line]
    assert sorted(listed) == sorted(f"yapp,{name}" for name in model.STATISTICS)


WRONG = [("nonsense", f"no such statistic; known: {', '.join(model.STATISTICS)}"), ("check,motr.rate=1", 'no message "motr"'),
         ("summary,filter=taurus.motor.nonsense == 1", "the filter taurus.motor.nonsense == 1 is not one"),
         ("summary,filter=(", "the filter ( is not one"), ("csv,/proc/none/x", "cannot be made")]


@pytest.mark.parametrize("argument, text", levels.few(WRONG, [WRONG[0], WRONG[2], WRONG[4]], several=True))
def test_wrong_arguments(folder, home, argument, text):
    returned, _, errors = z(folder, argument)
    assert returned == 21
    assert text in errors and "Lua" not in errors and ".lua" not in errors  # no place in our source


def test_a_folder_that_is_not_writable(folder, home):
    (folder / "closed").mkdir()
    (folder / "closed").chmod(0o555)
    (folder / "file").write_text("")
    if os.geteuid() or tshark._user():  # to root nothing is closed
        assert z(folder, "csv,closed/table")[0] == 21
        assert z(folder, "csv,closed")[0] == 21
    for argument in ("csv,file/table", "csv,file"):
        returned, _, errors = z(folder, argument)
        assert returned == 21 and f"the folder {argument[4:]} cannot be made" in errors


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_full_disk(folder, home):
    for argument in ("csv,-,motor", "summary", "check,crc=0"):
        returned, _, errors = z(folder, argument, command="exec >/dev/full; tshark -q -r run.pcapng")
        assert returned == 21 and "No space left" in errors, argument
    table = folder / "table"
    table.mkdir()
    table.chmod(0o777)
    os.symlink("/dev/full", table / "motor.csv.part")
    returned, _, errors = z(folder, "csv,table")
    assert returned == 21 and "No space left" in errors
    assert list(table.iterdir()) == []


def test_filter_decides_what_counts(folder, home):
    for case, rule, code in (("fault", "fault=0", 20), ("fault", "fault=0,filter=frame.number > 60", 0),
                             ("fault", "fault=0,filter=frame.number > 1000", 21),
                             ("cut at the end", "incomplete=0,filter=frame.number < 140", 0),
                             ("cut at the end", "incomplete=0,filter=taurus.motor || yapp.id", 20)):
        assert z(folder, f"check,{rule}", data=CASES[case][0])[0] == code, rule


def test_a_report_into_a_pipe(folder, home):
    """It is written, not replaced: with root's rights /dev/stdout would be a file from then on."""
    assert z(folder, "check,fault=0,junit=/dev/fd/3", command="exec 3>pipe.xml; tshark -q -r run.pcapng")[0] == 0
    assert 'tests="2" failures="0" errors="0"' in (folder / "pipe.xml").read_text()
