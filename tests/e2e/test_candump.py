# SPDX-License-Identifier: GPL-2.0-or-later
"""candump text opened by name: every form gives the frames it was printed from, and no other file is taken.

The captures are what candump 2020.11 and log2long print for the frames listed here, or were
written by hand where a comment says so.
"""
import subprocess

import pytest

import levels
import tshark

CAPTURES = tshark.CAPTURES / "candump"
REGISTER = f"""
package.path = "{tshark.PLUGIN}/?.lua" -- and nowhere else
require("yapp.file.readers").register {{}}
io.stderr:write("reader registered\\n")
"""


def run(folder, *arguments, stdin=None):
    """Runs tshark with the readers alone, which must have been loaded: as root, tshark 4.4 leaves them out without a word."""
    script = folder / "register.lua"
    script.write_text(REGISTER)
    done = tshark.run("-X", f"lua_script:{script}", *arguments, plugin=False, stdin=stdin)
    assert "reader registered" in done.stderr
    return done


FIELDS = ["sll.ifindex", "sll.pkttype", "can.id", "can.flags.xtd", "can.flags.rtr", "can.flags.err", "can.len",
          "canfd.flags.brs", "canfd.flags.esi", "data", "frame.time_epoch", "frame.protocols"]


def rows(folder, *arguments, stdin=None):
    """One dictionary a frame. Flags are "0" or "1" whatever the version prints. No dissector may have failed."""
    wanted = [part for name in [*FIELDS, tshark.LUA_ERROR] for part in ("-e", name)]
    out = run(folder, *arguments, "-T", "fields", *wanted, stdin=stdin).stdout.splitlines()
    assert all(line.endswith("\t") for line in out), tshark.LUA_ERROR
    flags = {"True": "1", "False": "0"}
    return [dict(zip(FIELDS, (flags.get(value, value) for value in line.split("\t")))) for line in out]


def frame(ident, data="", **other):
    """A frame as FIELDS show it."""
    extended, error = ident >= 0x800, ident & 0x20000000
    values = {"sll.ifindex": "0", "sll.pkttype": "0", "can.id": "" if error else str(ident), "data": data.lower(),
              "can.len": str(len(data) // 2), "can.flags.xtd": "" if error else str(int(extended)),
              "can.flags.rtr": "" if error else "0", "can.flags.err": "1" if error else "0",
              "canfd.flags.brs": "", "canfd.flags.esi": ""}
    if error:
        values["data"] = ""
    values.update(other)
    return values


def fd_frame(ident, data, brs, esi):
    return frame(ident, data, **{"canfd.flags.brs": str(brs), "canfd.flags.esi": str(esi), "can.flags.rtr": "",
                                 "can.flags.err": ""})


def remote(ident, length):
    return frame(ident, "", **{"can.flags.rtr": "1", "can.len": str(length)})


def on_bus(number, one):
    return dict(one, **{"sll.ifindex": str(number)})


def sent(one):
    return dict(one, **{"sll.pkttype": "4"})


MESSAGE = [frame(0x08404000, "BBBE6FC720000000"), frame(0x08408000, "FD7FFD7FFD7FFD7F"),
           frame(0x08408000, "F5AFFD7F18010000"), frame(0x08408000, "014000000000E38C"),
           frame(0x0840C000, "D23CE04E000005FF")]
TWO_BUSES = [on_bus(bus, one) for one in MESSAGE for bus in (0, 1)]
STANDARD = [frame(0x123, "0102030405060708"), frame(0x7FF), frame(1, "FF")]
ERRORS = [frame(0x20000004, "0008000000000000"), frame(0x20000088, "000002190000607F")]
FD_DATA = ["0001020304050607", "000102030405060708090A0B", "".join(f"{255 - i:02X}" for i in range(64))]
FD = [fd_frame(0x08404000, FD_DATA[0], 0, 0), fd_frame(0x123, FD_DATA[1], 1, 0),
      fd_frame(0x08404001, FD_DATA[2], 1, 1)]
# The screen tells the flags of CAN FD with -x only.
FD_WITHOUT_FLAGS = [dict(one, **{"canfd.flags.brs": "0", "canfd.flags.esi": "0"}) for one in FD]
SENT_AND_RECEIVED = [sent(one) if i % 2 == 0 else one for i, one in enumerate(MESSAGE)]

# Microseconds from each frame to the next in the captures.
GAPS = [130, 120, 141, 125, 118, 133, 127, 140, 119, 122]
ABSOLUTE, RELATIVE = 1700000000000001000, 0


def stamps(start, count):
    """Times from `start` (nanoseconds) on, as frame.time_epoch prints them."""
    times = [start + 1000 * sum(GAPS[:i]) for i in range(count)]
    return [f"{time // 10 ** 9}.{time % 10 ** 9:09d}" for time in times]


def deep(*row):
    """A form whose lines the pure tests know: in test-all only."""
    return pytest.param(row, marks=levels.deep)


# File, its frames, the time of the first one; None where the file has no times.
FILES = [
    ("screen_none.txt", MESSAGE, None),
    ("screen_absolute.txt", MESSAGE, ABSOLUTE),
    ("screen_delta.txt", MESSAGE, RELATIVE),
    deep("screen_zero.txt", MESSAGE, RELATIVE),
    ("screen_date.txt", MESSAGE, ABSOLUTE),
    deep("screen_ascii.txt", MESSAGE, RELATIVE),
    deep("screen_binary_swapped.txt", MESSAGE, None),
    deep("screen_color1.txt", TWO_BUSES, None),
    deep("screen_color2.txt", TWO_BUSES, None),
    ("screen_color3.txt", TWO_BUSES, ABSOLUTE),
    deep("screen_standard_ids.txt", STANDARD, RELATIVE),
    ("screen_mixed_ids.txt", MESSAGE[:1] + STANDARD + MESSAGE[1:], RELATIVE),
    ("screen_direction.txt", SENT_AND_RECEIVED + FD, RELATIVE),
    deep("screen_remote.txt", [remote(0x123, 0), remote(0x08404000, 8)] + MESSAGE, RELATIVE),
    ("screen_errors.txt", MESSAGE[:2] + ERRORS + MESSAGE[2:], RELATIVE),
    ("screen_drops.txt", MESSAGE, RELATIVE),
    deep("screen_fd.txt", FD_WITHOUT_FLAGS, RELATIVE),
    deep("screen_two_buses.txt", TWO_BUSES, ABSOLUTE),
    ("log_two_buses.log", TWO_BUSES, ABSOLUTE),
    deep("log_bus_names.log", TWO_BUSES, ABSOLUTE),
    ("log_direction.log", SENT_AND_RECEIVED, ABSOLUTE),
    ("log_fd.log", FD, ABSOLUTE),
    deep("log_plain_fd.log", FD, ABSOLUTE),
    ("log_errors.log", MESSAGE[:2] + ERRORS + [remote(0x123, 0), remote(0x08404000, 8)] + MESSAGE[2:], ABSOLUTE),
    deep("log_broken_lines.log", MESSAGE, ABSOLUTE),  # by hand
    ("log2long.txt", TWO_BUSES, ABSOLUTE),
    ("document.txt", MESSAGE, None),  # lines of the protocol's document, as the next one
    deep("document_crlf.txt", MESSAGE, None),
]


def assert_frames(shown, frames, times):
    """`times` as in stamps(), or None to leave them out."""
    assert [{name: row[name] for name in frames[0]} for row in shown] == frames
    assert all(row["frame.protocols"].startswith("sll:can") for row in shown)
    if times:
        assert [row["frame.time_epoch"] for row in shown] == times


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("way", ["one pass", "-2", "written"])
@pytest.mark.parametrize("form", FILES, ids=lambda row: row[0])
def test_form(folder, form, way):
    name, frames, start = form
    path, written = CAPTURES / f"candump_{name}", folder / "out.pcapng"
    no_time = [""] * len(frames)
    times = stamps(start, len(frames)) if start is not None else no_time
    if way == "written":
        run(folder, "-r", path, "-w", written)
        assert_frames(rows(folder, "-r", written), frames, times if times != no_time else None)
    else:
        assert_frames(rows(folder, *(["-2"] if way == "-2" else []), "-r", path), frames, times)


def test_nanoseconds(folder):
    times = [f"{int(time[:10])}.{int(time[11:]) + i * 111 + 1:09d}" for i, time in enumerate(stamps(ABSOLUTE, 5))]
    path, written = CAPTURES / "candump_log_nanoseconds.log", folder / "out.pcapng"  # by hand
    assert_frames(rows(folder, "-r", path), MESSAGE, times)
    run(folder, "-r", path, "-w", written)
    assert_frames(rows(folder, "-r", written), MESSAGE, times)


def test_plain_logs_stay_with_the_builtin_reader(folder):
    shown = rows(folder, "-r", CAPTURES / "candump_log_plain.log")
    assert [row["data"] for row in shown] == [one["data"] for one in MESSAGE]
    assert not any("sll" in row["frame.protocols"] for row in shown)


def test_ids_in_a_plain_log(folder):
    """The reader of 4.6 goes by an id's value: the Command of the document, ID 0, would be no extended frame to it."""
    path = CAPTURES / "candump_log_low_ids.log"  # by hand
    shown = rows(folder, "-r", path)
    assert [(row["can.id"], row["can.flags.xtd"], row["can.flags.err"]) for row in shown] == [
        ("0", "1", "0"), ("", "", "1"), (str(0x123), "1", "0"), (str(0x123), "0", "0")]
    shown = tshark.fields(path, ["taurus.command.key"])
    assert shown == [["0x5a"], [""], [""], [""]]


def test_lines_that_are_not_understood_are_told(folder):
    path = CAPTURES / "candump_log_broken_lines.log"
    errors = run(folder, "-r", path).stderr
    for text in ("5: not understood, counts as a lost packet: \"(170", "7: not understood, counts as a lost packet: \"can0  interface down\"",
                 "9: not understood"):
        assert f"candump reader: line {text}" in errors


@pytest.mark.parametrize("line", ["  can0  08404000   [8]  00`00`00`20`C7`6F`BE`BB   `... .o..`",
                                  "  can0  123   [2]  00000001 11111110", "  can0  123   {E}  00 11 22 33 44 55 66 77"],
                         ids=["-S", "-i", "-8"])
def test_forms_that_do_not_open(folder, line):
    """candump -S, -i and -8: Wireshark says that the file is none that it knows."""
    path = folder / "run.txt"
    path.write_text(f"{line}\n" * 5)
    done = tshark.run("-r", path, check=False)
    assert done.returncode and "isn't a capture file" in done.stderr


def log_text(count, buses):
    lines = [f"(17000{i // 1000:05d}.{i % 1000:06d}) can{buses(i)} 123#{i:08X}\n" for i in range(count)]
    return "".join(lines)


LINES = levels.size(8000, 20000)
LARGE = {
    "two buses": log_text(LINES, lambda i: i % 2),
    "one bus": log_text(LINES, lambda i: 0),
    "second bus at the end": log_text(LINES, lambda i: i // (LINES - 1)),
}


@levels.each_once
@pytest.mark.parametrize("name", LARGE)
@pytest.mark.parametrize("way", ["file", "-2", "redirection", "pipe"])
def test_files_redirections_and_pipes(folder, name, way):
    path = folder / "large.log"
    path.write_text(LARGE[name])
    if way == "redirection":
        with open(path, "rb") as stdin:
            shown = rows(folder, "-r", "-", stdin=stdin)
    elif way == "pipe":
        with subprocess.Popen(["cat", path], stdout=subprocess.PIPE) as cat:
            shown = rows(folder, "-r", "-", stdin=cat.stdout)
    else:
        shown = rows(folder, *(["-2"] if way == "-2" else []), "-r", path)
    assert [row["data"] for row in shown] == [f"{i:08x}" for i in range(LINES)]


