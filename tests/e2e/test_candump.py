# SPDX-License-Identifier: GPL-2.0-or-later
"""candump text opened by name: every form gives the frames it was printed from, and no other file is taken.

The captures are what candump 2020.11 and log2long print, or were written by hand where a comment says so.
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


FIELDS = ["sll.ifindex", "can.id", "data", "can.flags.xtd", "can.flags.err", "frame.time_epoch", "frame.protocols"]


def rows(folder, *arguments, stdin=None):
    """One dictionary a frame. Flags are "0" or "1" whatever the version prints. No dissector may have failed."""
    wanted = [part for name in [*FIELDS, tshark.LUA_ERROR] for part in ("-e", name)]
    out = run(folder, *arguments, "-T", "fields", *wanted, stdin=stdin).stdout.splitlines()
    assert all(line.endswith("\t") for line in out), tshark.LUA_ERROR
    flags = {"True": "1", "False": "0"}
    return [dict(zip(FIELDS, (flags.get(value, value) for value in line.split("\t")))) for line in out]


MESSAGE = [(0, 0x08404000, "bbbe6fc720000000"), (0, 0x08408000, "fd7ffd7ffd7ffd7f"), (0, 0x08408000, "f5affd7f18010000"),
           (0, 0x08408000, "014000000000e38c"), (0, 0x0840C000, "d23ce04e000005ff")]  # bus, CAN id, data
TWO_BUSES = [(bus, *one[1:]) for one in MESSAGE for bus in (0, 1)]
GAPS = [130, 120, 141, 125, 118, 133, 127, 140, 119, 122]  # microseconds from each frame to the next in the captures
ABSOLUTE, RELATIVE = 1700000000000001000, 0


def stamps(start, count):
    """Times from `start` (nanoseconds) on, as frame.time_epoch prints them."""
    times = [start + 1000 * sum(GAPS[:i]) for i in range(count)]
    return [f"{time // 10 ** 9}.{time % 10 ** 9:09d}" for time in times]


# File, its frames or how many they are, the time of the first one; None where the file has no times.  What a frame is made of,
# test_file_candump_line.lua has.
FILES = [
    ("screen_none.txt", MESSAGE, None), ("screen_absolute.txt", MESSAGE, ABSOLUTE), ("screen_delta.txt", MESSAGE, RELATIVE),
    ("screen_date.txt", MESSAGE, ABSOLUTE), ("screen_color3.txt", TWO_BUSES, ABSOLUTE), ("screen_drops.txt", MESSAGE, RELATIVE),
    ("screen_mixed_ids.txt", 8, RELATIVE), ("screen_direction.txt", 8, RELATIVE), ("screen_errors.txt", 7, RELATIVE),
    ("log_two_buses.log", TWO_BUSES, ABSOLUTE), ("log_direction.log", MESSAGE, ABSOLUTE), ("log_fd.log", 3, ABSOLUTE),
    ("log_errors.log", 9, ABSOLUTE), ("log2long.txt", TWO_BUSES, ABSOLUTE), ("document.txt", MESSAGE, None),
]
DEEP = [
    ("screen_zero.txt", MESSAGE, RELATIVE), ("screen_ascii.txt", MESSAGE, RELATIVE), ("screen_binary_swapped.txt", MESSAGE, None),
    ("screen_color1.txt", TWO_BUSES, None), ("screen_color2.txt", TWO_BUSES, None), ("screen_standard_ids.txt", 3, RELATIVE),
    ("screen_remote.txt", 7, RELATIVE), ("screen_fd.txt", 3, RELATIVE), ("screen_two_buses.txt", TWO_BUSES, ABSOLUTE),
    ("log_bus_names.log", TWO_BUSES, ABSOLUTE), ("log_plain_fd.log", 3, ABSOLUTE), ("log_broken_lines.log", MESSAGE, ABSOLUTE),
    ("document_crlf.txt", MESSAGE, None),
]


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("way", ["one pass", "-2", "written"])
@pytest.mark.parametrize("form", levels.few(FILES + DEEP, FILES), ids=lambda row: row[0])
def test_form(folder, form, way):
    name, frames, start = form
    path = CAPTURES / f"candump_{name}"
    if way == "written":
        run(folder, "-r", path, "-w", folder / "out.pcapng")
        path, start = folder / "out.pcapng", "any" if start is None else start
    shown = rows(folder, *(["-2"] if way == "-2" else []), "-r", path)
    found = [(int(row["sll.ifindex"]), int(row["can.id"] or -1), row["data"]) for row in shown]
    assert found == frames or len(found) == frames
    assert all(row["frame.protocols"].startswith("sll:can") for row in shown)
    times = [""] * len(shown) if start is None else stamps(0 if start == "any" else start, len(shown))
    assert start == "any" or [row["frame.time_epoch"] for row in shown] == times


def test_lines_that_are_not_understood_are_told(folder):
    errors = run(folder, "-r", CAPTURES / "candump_log_broken_lines.log").stderr
    assert all(f"candump reader: line {number}: not understood, counts as a lost packet" in errors for number in (5, 7, 9))


def test_nanoseconds(folder):
    times = [f"{int(time[:10])}.{int(time[11:]) + i * 111 + 1:09d}" for i, time in enumerate(stamps(ABSOLUTE, 5))]
    run(folder, "-r", CAPTURES / "candump_log_nanoseconds.log", "-w", folder / "out.pcapng")  # by hand
    for path in (CAPTURES / "candump_log_nanoseconds.log", folder / "out.pcapng"):
        assert [row["frame.time_epoch"] for row in rows(folder, "-r", path)] == times


def test_plain_logs_stay_with_the_builtin_reader(folder):
    shown = rows(folder, "-r", CAPTURES / "candump_log_plain.log")
    assert [row["data"] for row in shown] == [data for *_, data in MESSAGE]
    assert not any("sll" in row["frame.protocols"] for row in shown)


def test_ids_in_a_plain_log(folder):
    """The reader of 4.6 goes by an id's value: the Command of the document, ID 0, would be no extended frame to it."""
    path = CAPTURES / "candump_log_low_ids.log"  # by hand
    shown = rows(folder, "-r", path)
    assert [(row["can.id"], row["can.flags.xtd"], row["can.flags.err"]) for row in shown] == [
        ("0", "1", "0"), ("", "", "1"), (str(0x123), "1", "0"), (str(0x123), "0", "0")]
    shown = tshark.fields(path, ["taurus.command.key"])
    assert shown == [["0x5a"], [""], [""], [""]]


def log_text(count, buses):
    lines = [f"(17000{i // 1000:05d}.{i % 1000:06d}) can{buses(i)} 123#{i:08X}\n" for i in range(count)]
    return "".join(lines)


LINES = levels.size(4000, 20000)
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
