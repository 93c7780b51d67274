# SPDX-License-Identifier: GPL-2.0-or-later
"""The CI recipe in a real shell, on what it must let pass and on what it must stop; and how statistics end otherwise."""
import json
import os
import re
import shlex
import shutil
import struct
import subprocess

import pytest

import capture_file
import levels
import make
import model
import tshark
from can_generator import Frame, Sent

RECIPE = next(line.strip() for line in (tshark.ROOT / "docs/rules.md").read_text().splitlines()
              if line.startswith("    tshark -q -r docs/flight.pcapng")).replace("docs/flight", "run")
MOTOR, OTHER = 0x210, 0x310
CAPTURES = tshark.CAPTURES
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


def cut_in(place):
    """The snap length left two bytes of one frame of a message with a fault."""
    def change(sent):
        frames = with_fault(sent)
        frames[place].captured = 2
        return frames
    return change


def pcapng(placed, buses=("can0",)):
    head = capture_file.section(*(capture_file.interface(capture_file.SOCKETCAN, name, capture_file.NANOSECONDS) for name in buses))
    return head + b"".join(capture_file.packet(at, frame.record(), frame.bus, None if frame.captured is None else 8 + frame.captured)
                           for at, frame in placed)


CLEAN = flight()


def installed(folder, change=None):
    """A home with the plugin in its plugin folder, and what a change makes of it."""
    plugin = tshark.install_plugin(folder / "home" / tshark.PERSONAL_FOLDER / "yapp")
    if change:
        change(plugin)
    tshark.open_to_all(folder)
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
    path.write_text(path.read_text().replace('"Board Revision"', '"Board Revision", length = "x"'))


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
    for passes in (), ("-2",):
        assert tshark.run(*passes, "-q", "-r", folder / "run.pcapng", "-z", "yapp,check,fault=0", check=False).returncode == 20
    arguments = ["-2", "-R", "yapp.id == 0x210", "-q", "-r", folder / "run.pcapng"]
    done = tshark.run(*arguments, "-z", "yapp,check,fault=0", "-z", "yapp,faults", check=False)
    assert done.returncode == 21 and "what came before its messages is not known" in done.stdout
    said = "nothing tells the buses of 0x210 apart"
    assert said in done.stderr and said in done.stdout
    done = tshark.run(*arguments, "-z", "yapp,csv,-,motor")
    assert said not in done.stdout + done.stderr


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
    assert returned == 20


def test_a_capture_that_is_written(folder):
    assert gate(folder, CASES["fault"][0], RECIPE.replace("-q", "-w out.pcapng"))[0] == 20
    frames = shell(folder, "tshark -r out.pcapng -T fields -e frame.number", folder / "home")[1]
    assert len(frames.split()) == 150


# No false all-clear --------------------------------------------------------------------------------------------------

CASES_FOLDER = CAPTURES / "cases"
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
    ("t3_tcp_out_of_order_fault.pcap", "", 20, {"fault"}),
    ("t4_tcp_segment_missing.pcap", "", 20, {"dropped"}),
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
    rates = [(line["seen"], line["margin"]) for line in lines if line.get("rule") == "motor.rate=9..11"]
    assert all(margin == pytest.approx(min(seen - 9, 11 - seen)) for seen, margin in rates)
    assert [line["rule"] for line in lines if "rule" in line]
    assert all(line["time"] for line in lines if line.get("kind") == "dropped" and "isb" not in name)  # a count of an interface
    kinds = {line["kind"] for line in lines if "kind" in line}
    assert failed - {"motor.rate"} <= kinds


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


def undecoded_faults(*arguments):
    """What faults prints of a capture whose sources are not all decoded: their number is unknown, the exit code 21."""
    done = tshark.run("-q", *arguments, "-z", "yapp,faults", check=False)
    assert done.returncode == 21 and re.match(r"YAPP faults: UNKNOWN, \d+ of \d+ sources? not decoded, 0 in what was decoded\n", done.stdout)
    return done.stdout.splitlines()[1:]


@pytest.mark.parametrize("seq", [0, 7], ids=["not numbered", "numbered, two passes"])
def test_eight_controllers_without_a_preference(folder, seq):
    """Every answer says that six of them were not decoded; the preference that it suggests finds the fault."""
    (folder / "run.pcapng").write_bytes(controllers(EIGHT, seq=seq))
    text = "120 messages were not decoded: can0 0x211, 0x212, 0x213, can1 0x211, 0x212, 0x213 " \
        "(32 bytes each, the size of Motor Data). Try -o yapp.motor_ids:0x210-0x213"
    taps = [argument for what in [*model.IN_TEXT, "check"] for argument in ("-z", f"yapp,{what}")]
    done = tshark.run(*["-2"] * bool(seq), "-q", "-r", folder / "run.pcapng", *taps, check=False)
    said = done.stdout.splitlines()
    assert done.returncode == 20 and "YAPP faults: UNKNOWN, 6 of 8 sources not decoded, 0 in what was decoded" in said
    assert [following for line, following in zip(said, said[1:]) if line.startswith("YAPP")] == [text] * (len(model.IN_TEXT) + 1)
    options = shlex.split(text.partition(". Try ")[2])
    done = tshark.run(*options, "-q", "-r", folder / "run.pcapng", "-z", "yapp,faults", "-z", "yapp,check,unknown=0")
    assert "motor_overcurrent" in done.stdout and "not decoded" not in done.stdout
    done = tshark.run(*options, "-q", "-r", folder / "run.pcapng", "-z", "yapp,compare,json")
    assert {json.loads(line)["spread"] for line in done.stdout.splitlines()} == {0}


def command_payload(index):
    return bytes([1, 0xA5 if index % 2 else 0x5A, 1, index, 0x7F, 0xFD, 0x7F])


def looks_else(index):
    """A single frame of another program."""
    data = bytearray(command_payload(index))
    data[index % 3] = 9
    return Frame(0x006 << 18, bytes(data))


# Frames on can1 by the number of a message, what is said of 20 of them, and the options that decode them.
UNDECODED = {
    "an ID that is not listed, beside other programs": (
        lambda index: [Frame(0x005 << 18, command_payload(index)), looks_else(index)],
        "0x5 (7 bytes each, the size of Command). Try -o yapp.command_ids:0x0,0x5", ["-o", "yapp.command_ids:0x0,0x5"]),
    "a YAPP CTL other than 0": (
        lambda index: Sent(MOTOR, 1, index, overheated(index)).frames(),
        "0x210 (32 bytes each, Motor Data with a YAPP CTL other than 0, see yapp.all_extended)", ["-o", "yapp.all_extended:TRUE"]),
    "a Command with a byte more, beside frames that are none": (
        lambda index: [Frame(index, command_payload(index) + b"x"), Frame(index, bytes(8), kind="remote"),
                       Frame(index, bytes([index % 2, index, 2, 0, 0, 0, 0, 0])), Frame(index, command_payload(index)[:6])],
        "0x0 (8 bytes each, ", []),
}


@pytest.mark.parametrize("name", UNDECODED)
def test_single_frames_and_messages_that_are_not_decoded(folder, name):
    """They are said, with what decodes them: then nothing is left out, and a fault is found."""
    frames_of, text, options = UNDECODED[name]
    placed = list(CLEAN)
    for index in range(20):
        for place, frame in enumerate(frames_of(index)):
            frame.bus = 1
            placed.append((BEGIN + 40_000_000 + index * 100_000_000 + place * 300_000, frame))
    (folder / "run.pcapng").write_bytes(pcapng(sorted(placed, key=lambda one: one[0]), ("can0", "can1")))
    (line,) = undecoded_faults(*["-2"] * ("CTL" in text), "-r", folder / "run.pcapng")
    assert line.startswith(f"20 messages were not decoded: can1 {text}")
    if options:
        done = tshark.run(*options, "-q", "-r", folder / "run.pcapng", "-z", "yapp,faults", check=False)
        assert "not decoded" not in done.stdout and ("motor_overcurrent" in done.stdout) == ("32 bytes" in text)


@pytest.mark.parametrize("option", [("-o", "yapp.all_extended:TRUE"), ("-d", "can.subdissector,yapp_all")])
def test_single_frames_of_an_unknown_id_where_all_frames_are_yapp(folder, option):
    """They are shown as bytes, so they count as not decoded: from the first packet on, though nothing tells its CAN id."""
    frames = [Frame(1 << 18 | index, command_payload(1)) for index in range(3)] + Sent(MOTOR, 0, 1, motor_payload(1)).frames()
    (folder / "run.pcapng").write_bytes(pcapng([(BEGIN + index, one) for index, one in enumerate(frames)]))
    (line,) = undecoded_faults("-r", folder / "run.pcapng", *option)
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
    runs = [(folder / "run.pcapng", how) for how in ("-q", "-V", "-2q")] + [(CAPTURES / "can/remote_frames.pcap", "-q")]
    for capture, how in runs:
        lines = tshark.run(how, "-r", capture, "-z", "yapp,events,json", "-z", "yapp,csv,-,motor", "-z", "yapp,csv,-,command", "-z",
                           "yapp,check,incomplete=0,crc=0,invalid=0").stdout.splitlines()
        if capture.parent == folder:
            events = [json.loads(line) for line in lines if line.startswith('{"kind"')]
            assert [(one["kind"], one["id"]) for one in events] == [("silence", 0x200)]  # of the one message of Health
            rows = [line.split(",")[4] for line in lines if re.match(r"1700000\d+\.\d{9},", line)]
            assert rows == ["528"] * 300  # and no Command


def test_what_no_message_is_found_in(folder):
    """It says what was there, and what to look at."""
    foreign = [(BEGIN + index, Frame(0x18FEF100, bytes(8))) for index in range(120)]
    standard = [(BEGIN + index, Frame(0x123, bytes(8), kind="standard")) for index in range(3)]
    extended = "no YAPP message found; 120 extended CAN frames were not dissected: see yapp.motor_ids, yapp.all_extended"
    for placed, text, *passes in ((foreign, extended), (flight(OTHER, seq=1, count=24), extended, "-2"),
                                  (standard, "no YAPP message found in 3 packets: see yapp.user_dlt"),
                                  ([], "no YAPP message found: the capture has no packets, or -R removed all of them", "-2")):
        (folder / "run.pcapng").write_bytes(pcapng(placed))
        done = tshark.run(*passes, "-q", "-r", folder / "run.pcapng", "-z", "yapp,summary", "-z", "yapp,faults,json", "-z",
                          "yapp,check", check=False)
        assert (done.returncode, done.stdout.splitlines()[1][:len(text)]) == (21, text)
        assert re.search(f"NOT JUDGED +fault=0 +{re.escape(text)}", done.stdout) and f"yapp: {text}" in done.stderr


def test_a_display_filter_narrows_no_statistic(folder):
    for options, is_said in (([], False), (["-n2Yyapp"], True)):
        done = tshark.run("-q", *options, "-r", CASES_FOLDER / "g0_clean.pcapng", "-z", "yapp,summary", "-z",
                          "yapp,faults,filter=yapp")
        assert [line.startswith("-Y does not narrow") for line in done.stdout.splitlines()].count(True) == is_said
        assert re.search(r"\n(bus +)?ID +message +field +unit +min +mean +max +count\n", done.stdout), "the columns of the values"


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
    for argument in ("csv,-,motor", "check,crc=0"):
        returned, _, errors = z(folder, argument, command="exec >/dev/full; tshark -q -r run.pcapng")
        assert returned == 21 and "No space left" in errors, argument


def test_filter_decides_what_counts(folder, home):
    for case, rules, code in (("fault", ["check,fault=0,filter=frame.number > 60", "check,fault=0,filter=frame.number > 1000"], 21),
                              ("cut at the end", ["check,incomplete=0,filter=frame.number < 140"], 0)):
        returned, output, _ = z(folder, *rules, data=CASES[case][0])
        assert returned == code and "FAILED" not in output and len(re.findall(r"\nok +(?:fault|incomplete)", output)) == 1, output


def test_a_report_into_a_pipe(folder, home):
    """It is written, not replaced: with root's rights /dev/stdout would be a file from then on."""
    assert z(folder, "check,fault=0,junit=/dev/fd/3", command="exec 3>pipe.xml; tshark -q -r run.pcapng")[0] == 0
    assert 'tests="2" failures="0" errors="0"' in (folder / "pipe.xml").read_text()


def test_the_rules_of_the_page(folder):
    """The ten that most flights need: the flight of the documents breaks some, and each is judged."""
    table = (tshark.ROOT / "docs/rules.md").read_text().partition("| question | line |")[2].partition("\n\n")[0]
    rules = re.findall("`(.*?)`", table)
    (folder / "hover.rules").write_text("\n".join(rules))
    done = tshark.run("-q", "-r", tshark.ROOT / "docs/flight.pcapng", "-z", "yapp,check,rules=hover.rules", cwd=folder, check=False)
    assert done.returncode == 20 and "yapp:" not in done.stderr, done.stderr
    verdicts = dict(re.findall(r"^(FAILED|NOT JUDGED|ok) +(\S+)", done.stdout, re.M))
    assert len(rules) == 10 and verdicts.keys() == {"FAILED", "ok"}, done.stdout
    assert "motor.rpm_error" in done.stdout.partition("\nok")[2]
