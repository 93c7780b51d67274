# SPDX-License-Identifier: GPL-2.0-or-later
"""Expert items: each has a capture, and a display filter that finds exactly its frames."""
import collections
import json
import pathlib
import re
import sys

import pytest

import levels
import model
import published
import tshark

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test_captures"))
import expected  # noqa: E402
import make  # noqa: E402

pytestmark = [levels.by_route, levels.together("captures")]

# Expert item, capture, its frames; severity, text; and what stands in the tree of the first of the frames, by the numbers and
# names of this packet.
EXPERTS = [
    ("yapp.crc.bad", "bad_crc_can", [5], "Error", "Bad CRC", "Calculated CRC: 0xc76fbebb"),
    ("yapp.crc.bad", "bad_crc_uart", [1], "Error", "Bad CRC", "Calculated CRC: 0xc76fbebb"),
    ("yapp.fragment.orphan", "end_without_start", [1], "Warning", "Middle or End without a Start",
     "Middle or End without a Start"),
    ("yapp.fragment.incomplete", "lost_middle", [4], "Warning", "Message with bytes missing",
     "The message that started in frame 1 has 24 of 32 bytes"),
    ("yapp.fragment.overrun", "overrun", [6], "Warning", "More bytes than the message's size",
     "The message that started in frame 1 has 40 of 32 bytes"),
    ("yapp.size.mismatch", "wrong_size", [1, 2, 3, 7, 8], "Warning", "Payload length is not the catalogue's",
     "Payload: "),
    ("yapp.id.unknown", "unknown_id", [1, 5], "Note", "Message ID is not in the catalogue",
     "Message ID: Unknown (0x00000123)"),
    ("yapp.reserved.nonzero", "reserved_nonzero", [1], "Warning", "Reserved bytes are not 0",
     "Reserved: 0x1234"),
    ("yapp.can.ctrl.invalid", "ctrl_4_to_15", list(range(1, 13)), "Warning", "CAN CTRL is not defined",
     "CAN frame: Unknown (4)"),
    ("yapp.stream.skipped", "uart_shell", [1], "Note", "Bytes that belong to no frame",
     "Skipped bytes: 6c6f67696e3a20"),
    ("yapp.truncated", "cut_middle", [3], "Warning", "The capture cut the packet short",
     "The capture cut the packet short"),
    ("yapp.late", "events", [8], "Warning", "A long gap before this message", "Silent for 0.500 s"),
    ("taurus.fault.active", "info_column", [5], "Error", "Fault flags are set",
     "Fault Flags: 0x10010000 (motor_overcurrent, hall_timeout)"),
    ("taurus.fault.raised", "events", [3, 4], "Error", "A fault was raised",
     "Fault Flags raised: 0x00010000 (motor_overcurrent)"),
    ("taurus.fault.cleared", "events", [5, 7], "Note", "A fault was cleared",
     "Fault Flags cleared: 0x00010000 (motor_overcurrent)"),
    ("taurus.reboot", "events", [7], "Warning", "Controller rebooted (its clock went back)", "Controller rebooted (its clock went back by 10.2 s)"),
    ("taurus.stale", "events", [6], "Warning", "Controller clock did not advance", "Clock drift: -"),
    ("taurus.command.key.invalid", "invalid_key", [1, 4], "Warning", "Key is not defined (the controller ignores this command)",
     "Key: "),
    ("taurus.value.special", "document_motor", [5], "Note", "Reserved value: not a number, infinite or out of range",
     "ESC Temperature: Not a Number (0)"),
    ("taurus.flags.undefined", "fault_flags", [21, 29, 34], "Note", "A bit is set that no table defines",
     "Undefined bits: 0x00080000"),
    ("taurus.value.invalid", "undefined_values", [1, 2, 7], "Warning", "Value that is not defined", "Enabled: "),
]
KNOWN_LATER = [("yapp.unfinished", "unfinished", [8], "Warning", "Message cut off by the end of the capture"),
               ("yapp.unfinished", "unfinished_uart", [3], "Warning", "Message cut off by the end of the capture"),
               ("yapp.fragment.duplicate", "extra_middle", [4], "Note", "Frame delivered twice")]


MOTOR = "FD7FFD7FFD7FFD7FF5AFFD7F1801000001400000"  # up to the fault flags; the clock is at byte 22


def clocks(seconds):
    """Motor Data every 0.1 s, with these times of the controller's clock."""
    lines = [f"{number / 10:.1f} can0 fd [210 {MOTOR}0000{int(clock * 10**9).to_bytes(8, 'little').hex()}05FF]\n"
             for number, clock in enumerate(seconds)]
    return make.pcap(make.Source("".join(lines)))


# Expert item, the controller's clock in each message, the frames, and the label, which has the numbers.
CLOCKS = [
    ("taurus.jump", [1.0, 1.1, 3601.2, 3601.3], [3], "Controller's clock jumped ahead by 3600.0 s"),
    ("yapp.source.shared", [time + 50 * (number % 2) for number, time in enumerate([one / 10 for one in range(10, 30)])], None,
     "Two controllers send this ID on one bus: their clocks alternate"),
]


@levels.by_version
@pytest.mark.parametrize("name, seconds, frames, label", CLOCKS, ids=[row[0] for row in CLOCKS])
def test_what_the_clocks_say(folder, name, seconds, frames, label):
    """Once, with the number in the label; the same in two passes."""
    (folder / "clocks.pcap").write_bytes(clocks(seconds))
    for passes in ((), ("-2",)):
        shown = tshark.run(*passes, "-r", folder / "clocks.pcap", "-Y", name, "-O", "taurus").stdout
        found = [int(number) for number in re.findall(r"(?m)^Frame (\d+):", shown)]
        assert found == frames if frames else len(found) == 1
        assert label in shown


@levels.by_version
def test_a_command_turns_motors_off(folder):
    """At the Command from 1 to 0 while a motor turns: not at one that repeats it, nor where the key is undefined."""
    turns = MOTOR[:12] + "00C0" + MOTOR[16:] + "0000" + 8 * "00" + "05FF"
    command = "fd [000 {:02}{:02X}01FD7FFD7F]".format
    sent = [f"fd [210 {turns}]", command(1, 0xA5), command(0, 0), command(0, 0xA5), command(0, 0xA5), command(1, 0xA5)]
    (folder / "off.pcap").write_bytes(make.pcap(make.Source("".join(f"{n / 10:.1f} can0 {one}\n" for n, one in enumerate(sent)))))
    for passes in ((), ("-2",)):
        shown = tshark.run(*passes, "-r", folder / "off.pcap", "-Y", "taurus.disabled", "-O", "taurus").stdout
        assert re.findall(r"(?m)^Frame (\d+):", shown) == ["4"]
        assert "A Command turned off motors that were turning" in shown


@levels.by_version
def test_the_first_frame_of_decode_as():
    """Without a tree nothing tells its CAN id; the headers of those behind it are read."""
    path = tshark.CAPTURES / "can/unknown_id.pcap"
    shown = tshark.run("-q", "-r", path, "-d", "can.subdissector,yapp_all", "-z", "expert").stdout
    assert re.findall(r"(\d+) +Undecoded +YAPP\w* +(.*)", shown)[0] == ("1", "The CAN id of this frame is not known")


@levels.without_tshark("of the tables of the tests alone")
def test_every_expert_item_has_a_capture():
    """That of yapp.copy: test_copies.py."""
    found = {row[0] for row in EXPERTS + KNOWN_LATER} | {row[0] for row in CLOCKS} | {"taurus.disabled", "yapp.copy"}
    assert found == set(model.EXPERTS + model.EVENT_EXPERTS), "a row of EXPERTS, with its capture"


def found_and_shown(name, capture, passes):
    """The frames of a capture with an expert item, and all texts of the first of them."""
    having = [(number, packet) for number, packet in enumerate(expected.trees(capture, passes), 1)
              if any(one.get("name") == name for one in packet.iter())]
    return [number for number, _ in having], [one.get("showname") for _, packet in having[:1] for one in packet.iter()]


@pytest.mark.parametrize("name, capture, frames, severity, text, label", EXPERTS)
def test_where_and_what(name, capture, frames, severity, text, label):
    found, texts = found_and_shown(name, capture, "one pass")
    assert found == frames
    assert any(re.match(rf"Expert Info \({severity}/\w+\): {re.escape(text)}$", one or "") for one in texts)
    first = expected.together(expected.takes_all(capture))[2][capture] + 1
    assert any((one or "").startswith(label.replace("frame 1 ", f"frame {first} ")) for one in texts), texts


@pytest.mark.parametrize("name, capture, frames, severity, text", KNOWN_LATER)
def test_what_is_known_on_a_later_look(name, capture, frames, severity, text):
    assert found_and_shown(name, capture, "one pass")[0] == []
    found, texts = found_and_shown(name, capture, "-2")
    assert found == frames and any(re.match(rf"Expert Info \({severity}/\w+\): {re.escape(text)}$", one or "") for one in texts)


# Flags -----------------------------------------------------------------------------------------------------------

HELP = """return { { name = "motor", title = "Motor Data", id = 0x210, size = 32,
  { "before", "bytes", "Before", length = 18 },
  { "fault_flags", "uint32", "Fault Flags", group = "fault", alarm = true, flags = {
    { "motor_overcurrent", 0x10000, "Motor overcurrent", help = "look at the phases" },
    { "hall_timeout", 0x10000000, "Hall timeout" } } },
  { "behind", "bytes", "Behind", length = 10 } } }"""


def test_group_and_severity_of_each():
    """As the plugin registers them."""
    scripts = pathlib.Path(__file__).with_name("experts.lua"), tshark.PLUGIN / "yapp.lua"
    done = tshark.run(*(word for script in scripts for word in tshark.load(script)), "-r", make.capture("events")[0], "-q",
                      plugin=False, env={"YAPP_EXPERTS": "1"})
    shown = dict(line.split(" ", 1) for line in done.stdout.splitlines())
    assert shown == published.of("expert")


def test_help_of_a_flag(folder):
    """Where the flag is set; not where it is not.  And in the JSON of its fault."""
    (folder / "messages.lua").write_text(HELP)
    plugin = tshark.copy_plugin(folder / "plugin")
    (plugin / "taurus_fields.lua").write_text(HELP)
    done = tshark.run(*tshark.load(plugin / "yapp.lua"), "-r", make.capture("events")[0], "-O", "taurus", "-z", "yapp,faults,json",
                      plugin=False)
    trees = [tree for tree in re.split(r"(?m)^Frame \d+:", done.stdout)[1:] if "Taurus Motor Data" in tree]
    texts = [re.findall(r"(?m)^ +(Fault Flags: 0x.*)$", tree) for tree in trees]
    assert texts[1] == ["Fault Flags: 0x00010000 (motor_overcurrent); motor_overcurrent: look at the phases"]
    assert "look at" not in "".join(texts[0] + texts[3])
    faults = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert {(fault["flag"], fault["help"]) for fault in faults} == {("motor_overcurrent", "look at the phases"), ("hall_timeout", None)}


def test_one_message_has_one_item_of_each_kind_about_faults():
    """That they are set, raised, cleared; the item names the flags of all fields, above the values, with links to the
    changes before and behind."""
    flight = tshark.ROOT / "docs/flight.pcapng"
    rows = tshark.fields(flight, [f"taurus.fault.{name}" for name in ("active", "raised", "cleared")])
    assert [collections.Counter(column) for column in zip(*rows)] == [{"": len(rows) - count, "1": count} for count in (15, 1, 1)]
    text = tshark.run("-2", "-r", flight, "-Y", "frame.number in {719, 745, 908}", "-O", "taurus").stdout
    raised, between, cleared = text.split("Taurus Motor Data\n")[1:]
    lines = [line.strip() for line in raised.splitlines() if "Severity" not in line and "Group" not in line]
    assert lines[:3] == ["[Faults: motor_overcurrent, faulted, raised here]", "[Fault Flags: next change in: 908]",
                         "[Time since the oldest fault was raised: 0.000000000 seconds]"]
    assert lines[3].startswith("[Expert Info") and lines[3].endswith("Fault flags are set]")
    assert between.startswith("    [Faults: motor_overcurrent, faulted]") and "[Fault Flags: previous change in: 719]" in between
    assert cleared.startswith("    [Faults: none; motor_overcurrent, faulted cleared here]")
    assert "[Fault Flags: previous change in: 719]" in cleared
