"""Expert items: each has a capture, a display filter that finds exactly its frames, and a line in -z expert."""
import pathlib
import re
import sys

import pytest

import levels
import model
import tshark

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test_captures"))
import expected  # noqa: E402
import make  # noqa: E402

pytestmark = [levels.by_route, levels.together("captures")]
WIDE = {"-o": ["-o", "yapp.all_extended:TRUE"], "-d": ["-d", "can.subdissector,yapp"]}

# Every capture with expert items of YAPP's own: the frames of each.  Captures not named here have none.
YAPP = {
    "bad_crc_can": {"crc.bad": [5]},
    "bad_crc_uart": {"crc.bad": [1]},
    "ctrl_4_to_15": {"can.ctrl.invalid": list(range(1, 13))},
    "cut_end": {"truncated": [5]},
    "cut_middle": {"truncated": [3]},
    "cut_single": {"truncated": [1]},
    "cut_start": {"truncated": [1], "fragment.orphan": [2, 3, 4, 5]},
    "cut_uart": {"truncated": [1]},
    "cut_udp": {"truncated": [1]},
    "end_without_start": {"fragment.orphan": [1]},
    "extra_middle": {"fragment.overrun": [6]},
    "fd_multi_frame": {"id.unknown": [6]},
    "fd_padding_nonzero": {"size.mismatch": [1]},
    "lost_end": {"fragment.incomplete": [5]},
    "lost_middle": {"fragment.incomplete": [4]},
    "middle_without_start": {"fragment.orphan": [1, 2, 3]},
    "repeated_end": {"fragment.orphan": [6]},
    "repeated_start": {"fragment.incomplete": [2]},
    "repeated_start_sll2": {"fragment.incomplete": [2]},
    "reserved_nonzero": {"reserved.nonzero": [1]},
    "reserved_nonzero_uart": {"stream.skipped": [1]},  # in a stream these rule a frame out
    "start_12_bytes": {"size.mismatch": [1]},
    "start_3_bytes": {"fragment.incomplete": [1], "fragment.orphan": [2, 3, 4, 5]},
    "start_size_0": {"size.mismatch": [1], "fragment.orphan": [2, 3]},
    "start_size_65535": {"size.mismatch": [1], "fragment.incomplete": [5]},
    "uart_broken_off": {"stream.skipped": [2]},
    "uart_several": {"stream.skipped": [2]},
    "uart_shell": {"stream.skipped": [1]},
    "unknown_id": {"id.unknown": [1, 5]},
    "unknown_id_size_65535": {"fragment.incomplete": [3]},
    "unknown_id_uart": {"id.unknown": [1]},
    "wrong_size": {"size.mismatch": [1, 2, 3, 7, 8]},
    "wrong_size_uart": {"stream.skipped": [1]},
}


def experts(frames, prefix):
    """{expert item without its prefix: frames}."""
    found = {}
    for name in model.EXPERTS:
        numbers = [frame["frame"] for frame in frames if name in frame]
        if numbers and name.startswith(prefix):
            found[name[len(prefix):]] = numbers
    return found


@pytest.mark.parametrize("name", make.names())
def test_experts_of_every_capture(name):
    for passes in ("one pass", "-2"):
        if (name, passes) != ("two_buses_unnamed", "one pass"): # only what comes later says that nothing was cut off
            assert experts(expected.capture_shown(name, passes), "yapp.") == YAPP.get(name, {}), passes


# Expert item, capture, its frames, and its line in tshark -z expert: severity, text.
EXPERTS = [
    ("yapp.crc.bad", "bad_crc_can", [5], "Errors", "Bad CRC: received 0xc76fbe44, expected 0xc76fbebb"),
    ("yapp.crc.bad", "bad_crc_uart", [1], "Errors", "Bad CRC: received 0xc76fbe44, expected 0xc76fbebb"),
    ("yapp.fragment.orphan", "end_without_start", [1], "Warns", "End of a message whose Start is not here"),
    ("yapp.fragment.incomplete", "lost_middle", [4], "Warns",
     "The message that started in frame 1 ends with 24 of 32 bytes"),
    ("yapp.fragment.incomplete", "lost_end", [5], "Warns",
     "A new Start cuts off the message that started in frame 1: 24 of 32 bytes"),
    ("yapp.fragment.overrun", "extra_middle", [6], "Warns",
     "40 bytes for the 32 of the message that started in frame 1"),
    ("yapp.size.mismatch", "wrong_size", [1, 2, 3, 7, 8], "Warns", "Command has 6 bytes, the catalogue says 7"),
    ("yapp.id.unknown", "unknown_id", [1, 5], "Notes", "Message ID 0x123 is not in the catalogue"),
    ("yapp.reserved.nonzero", "reserved_nonzero", [1], "Warns", "The reserved bytes are 0x1234, not 0"),
    ("yapp.can.ctrl.invalid", "ctrl_4_to_15", list(range(1, 13)), "Warns", "CAN CTRL is 4; 0 to 3 are defined"),
    ("yapp.stream.skipped", "uart_shell", [1], "Notes", 'bytes that belong to no frame: "login: "'),
    ("yapp.truncated", "cut_middle", [3], "Warns", "The capture has 3 of the frame's 8 bytes"),
    ("taurus.fault.active", "info_column", [5], "Errors", "Fault Flags: motor_overcurrent, hall_timeout"),
    ("taurus.command.key.invalid", "invalid_key", [1, 4], "Warns",
     "Key: 0x00 is not a value that the document defines"),
    ("taurus.value.special", "document_motor", [5], "Notes", "ESC Temperature: Not a Number (0xff)"),
    ("taurus.flags.undefined", "health_status", list(range(5, 11)), "Notes",
     "Taurus Status: undefined bits 0x8"),
    ("taurus.value.invalid", "undefined_values", [1, 2, 7], "Warns",
     "Enabled: 0x02 is not a value that the document defines"),
]


def test_every_expert_item_has_a_capture():
    assert {row[0] for row in EXPERTS} == set(model.EXPERTS)


def filtered(capture, text, *options):
    return [int(number) for number, in tshark.fields(capture, ["frame.number"], *options, "-Y", text)]


@pytest.mark.parametrize("name, capture, frames, severity, text", EXPERTS)
def test_filter_and_expert_list(name, capture, frames, severity, text):
    path, options = make.capture(capture)[0], make.read(capture).options
    # What is printed of the frames that the filter finds, and behind it the list, which the filter does not concern.
    done = tshark.run(*options, "-r", path, "-Y", name, "-T", "fields", "-e", "frame.number", "-z", "expert")
    numbers, listed = re.fullmatch(r"(?s)((?:\d+\n)*)(.*)", done.stdout).groups()
    assert [int(number) for number in numbers.split()] == frames
    sections = dict(re.findall(r"(?ms)^(\w+) \(\d+\)\n=+\n(.*?)(?=^\w+ \(\d+\)$|\Z)", listed))
    assert re.search(rf"(?m)^ +\d+ +\w+ +YAPP(_SERIAL)?  .*{re.escape(text)}$", sections.get(severity, "")), listed


# Claims ----------------------------------------------------------------------------------------------------------

# Captures of what is not surely YAPP: the frames that are taken by default.
CLAIMED = {
    "start_3_bytes": [2, 3, 4, 5],  # the Middles and the End of a known ID
    "start_12_bytes": [2, 3, 4, 5],
    "start_size_0": [2, 3],
    "start_size_65535": [2, 3, 4, 5],
    "reserved_nonzero": [2, 3, 4, 5],
    "wrong_size": [4, 5, 6, 7],
    "unknown_id": [2, 3, 4, 5],  # a plausible Start and what follows
    "fd_multi_frame": [1, 2, 3, 4, 5, 6],
    "ctrl_4_to_15": [],
    "ctl_nonzero": [],
    "fd_padding_nonzero": [],
}


def test_captures_that_need_the_preference():
    assert set(CLAIMED) == {name for name in make.names() if make.read(name).options == WIDE["-o"]}


@pytest.mark.parametrize("name", CLAIMED)
def test_by_default_only_what_is_surely_yapp_is_taken(name):
    def is_right(frames):
        return [frame["frame"] for frame in frames] == CLAIMED[name]

    for passes in ("one pass", "-2"):
        assert is_right(expected.among_others(name, passes, [], is_right))


@pytest.mark.parametrize("passes", ["one pass", "-2 -Y"])
@pytest.mark.parametrize("name", CLAIMED)
def test_decode_as_shows_the_same_as_the_preference(name, passes):
    wanted = expected.capture_shown(name, passes)
    assert expected.among_others(name, passes, WIDE["-d"], lambda frames: frames == wanted) == wanted


# Flags -----------------------------------------------------------------------------------------------------------

SWEEPS = [("fault_flags", "taurus.motor.fault", model.FAULT, 34),
          ("status_flags", "taurus.motor.status", model.STATUS, 34),
          ("motor_state", "taurus.motor.state", model.STATE, 10),
          ("health_status", "taurus.health.status", model.HEALTH_STATUS, 10)]


@pytest.mark.parametrize("name, path, bits, last", SWEEPS, ids=[row[0] for row in SWEEPS])
def test_each_flag_is_found_in_its_frame_and_in_no_other(name, path, bits, last):
    """Frame 1 has no bit, frame n + 2 has bit n, the last frame has all."""
    frames = {flag: mask.bit_length() + 1 for mask, flag in bits.items()}
    there = [f"{path}.{flag} == 1 && frame.number == {number}" for flag, number in frames.items()]
    elsewhere = [f"{path}.{flag} == 1 && !(frame.number in {{{number}, {last}}})" for flag, number in frames.items()]
    everywhere = " && ".join(f"{path}.{flag} == 1" for flag in frames)
    capture = make.capture(name)[0]
    assert filtered(capture, " || ".join(there)) == sorted(frames.values())
    assert filtered(capture, " || ".join(elsewhere)) == []
    assert filtered(capture, everywhere) == [last]
