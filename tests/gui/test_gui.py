# SPDX-License-Identifier: GPL-2.0-or-later
"""Wireshark's windows: it decodes, filters and shows the tree; no error dialog at load, after reloading Lua plugins, after
opening another file."""
import os
import pathlib
import re
import shutil
import sys
import threading
import time

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import gui  # noqa: E402
import model  # noqa: E402
import published  # noqa: E402

pytestmark = pytest.mark.skipif(bool(gui.MISSING), reason=f"not installed: {', '.join(gui.MISSING)}")

# Counts the frames that have Taurus messages, and the errors in Lua, each time a file has been dissected; into the file
# of its name.
PROBE = """
local out = "%s"
local find_error = Field.new("_ws.lua.error")
local tap, count, errors = Listener.new("frame", "taurus || _ws.lua.error"), 0, 0
function tap.packet()
  if find_error() then errors = errors + 1 else count = count + 1 end
end
function tap.reset() count, errors = 0, 0 end
function tap.draw()
  local file = io.open(out, "w")
  file:write(count, " messages, ", errors, " errors")
  file:close()
end
"""


class Probe:
    """How many frames of Taurus Wireshark sees: it must look again after each step."""

    def __init__(self, folder):
        self.path = pathlib.Path(folder) / "count"
        self.script = pathlib.Path(folder) / "probe.lua"
        self.script.write_text(PROBE % self.path)

    def forget(self):
        self.path.unlink(missing_ok=True)

    def says(self, count, errors=0):
        return self.path.exists() and self.path.read_text() == f"{count} messages, {errors} errors"

    def wait_for(self, count, errors=0):
        try:
            gui.wait_for(lambda: self.says(count, errors))
        except AssertionError as error:
            says = self.path.read_text() if self.path.exists() else "nothing"
            raise AssertionError(f"not {count} messages, {errors} errors: {says}") from error


def assert_quiet(wireshark, title):
    """One window, that of the file, and nothing from Lua on stderr."""
    time.sleep(1)
    assert len(wireshark.windows()) == 1 and title in list(wireshark.windows().values())[0], wireshark.windows()
    assert "Lua" not in wireshark.stderr(), wireshark.stderr()
    assert wireshark.wireshark.poll() is None


@pytest.fixture
def captures():
    folder = gui.tshark.writable_folder()
    shutil.copy(gui.FLIGHT, folder / "first.pcapng")
    shutil.copy(gui.tshark.CAPTURES / "serial/document_udp.pcap", folder / "second.pcap")
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def open_file(wireshark, path):
    wireshark.keys("ctrl+o")
    dialog = wireshark.wait_for_window("Open Capture File")
    wireshark.type(path)
    wireshark.keys("Return")
    gui.wait_for(lambda: dialog not in wireshark.windows())
    wireshark.wait_for_window(path.name)


FAULT = ("Taurus Motor Data", "Fault Flags: 0x00010000 (motor_overcurrent)", "Motor overcurrent: True")


def test_no_error_dialog(captures):
    """Loads, decodes, filters, shows the tree; reloads with the filter in use; opens another file; reloads again."""
    probe = Probe(captures)
    with gui.Wireshark("-X", f"lua_script:{probe.script}", "-r", captures / "first.pcapng") as wireshark:
        wireshark.wait_for_window("first.pcapng")
        probe.wait_for(402)
        assert_quiet(wireshark, "first.pcapng")

        wireshark.filter("taurus.fault.active")
        wireshark.keys("ctrl+Home", "Tab", "ctrl+Right")  # the first packet; in the tree, Expand All
        wireshark.tree("Frame 719:", *FAULT)
        wireshark.keys("ctrl+End")
        wireshark.tree("Frame 893:", *FAULT)
        assert_quiet(wireshark, "first.pcapng")

        probe.forget()
        wireshark.press("ctrl+shift+l", until=lambda: probe.says(402))
        wireshark.keys("ctrl+Home")
        wireshark.tree("Frame 719:", "CRC good", "Taurus Motor Data")
        assert_quiet(wireshark, "first.pcapng")

        probe.forget()
        open_file(wireshark, captures / "second.pcap")
        probe.wait_for(1)
        wireshark.filter("taurus")  # it has no fault
        wireshark.keys("ctrl+Home")
        wireshark.tree("Frame 1:", "CRC good", "Taurus Motor Data")
        assert_quiet(wireshark, "second.pcap")

        probe.forget()
        wireshark.press("ctrl+shift+l", until=lambda: probe.says(1))
        wireshark.keys("ctrl+Home")
        wireshark.tree("Frame 1:", "CRC good", "Taurus Motor Data")
        assert_quiet(wireshark, "second.pcap")


def test_a_broken_catalogue_is_told_in_a_window(captures):
    """It names the message; when it is closed, the rest of the plugin works."""
    plugin, probe = gui.tshark.copy_plugin(captures), Probe(captures)
    catalogue = plugin / "taurus_fields.lua"
    catalogue.write_text(catalogue.read_text().replace("size = 32", "size = 31"))
    with gui.Wireshark("-X", f"lua_script:{probe.script}", "-r", captures / "first.pcapng", plugin=plugin) as wireshark:
        wireshark.wait_for_window("Wireshark", whole=True)
        wireshark.keys("Return")
        wireshark.wait_for_window("first.pcapng")
        probe.wait_for(167)  # Commands and Health
        assert_quiet(wireshark, "first.pcapng")


# The checks themselves ---------------------------------------------------------------------------------------------

def text_of(wireshark, title, part=""):
    """The text of a window of ours, once it has a part: until the window has the focus, another one answers."""
    wireshark.wait_for_window(title)

    def read():
        wireshark.clipboard("-i")
        wireshark.keys("Tab", "ctrl+a", "ctrl+c")
        text = wireshark.clipboard()
        return part in text and text
    return gui.wait_for(read)


def test_a_statistic_in_a_window(captures):
    with gui.Wireshark("-r", captures / "first.pcapng", "-z", "yapp,check,fault=0,crc=0") as wireshark:
        text = text_of(wireshark, "YAPP Check")
        assert "FAILED  fault=0" in text and "YAPP check: FAILED" in text
        assert wireshark.wireshark.poll() is None
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


# Under Tools, the last entry is YAPP; its entries by the alphabet.
TITLES = {name: row["title"] for name, row in published.inventory()["statistics"].items()}
MENU = sorted([*TITLES.values(), "Decode unknown IDs by size", "Help"])


def choose(wireshark, entry, title=None):
    """Chooses from the menu, until its window is there."""
    wireshark.press("alt+t", "Up", "Right", *["Down"] * MENU.index(entry), "Return",
                    until=lambda: any(name.endswith(f"YAPP {title or entry}") for name in wireshark.windows().values()))


def test_statistics_in_the_menu(captures):
    with gui.Wireshark("-r", captures / "first.pcapng") as wireshark:
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Faults")
        text = text_of(wireshark, "YAPP Faults")
        assert "YAPP faults: 1" in text and "motor_overcurrent" in text

        wireshark.clipboard("-i")
        wireshark.click("Copy")
        assert gui.wait_for(wireshark.clipboard, 20).splitlines() == text.splitlines()

        wireshark.click("Show")
        wireshark.wait_for_window("first.pcapng")
        wireshark.keys("ctrl+Home", "Tab", "ctrl+Right")
        wireshark.tree("Frame 719:", *FAULT)
        wireshark.keys("ctrl+Down")
        wireshark.tree("Frame 908:", "Fault Flags cleared: 0x00010000 (motor_overcurrent)")
        wireshark.clipboard("-i")
        wireshark.keys("ctrl+slash", "ctrl+a", "ctrl+c")
        assert gui.wait_for(wireshark.clipboard, 20) == "frame.number in {719, 908}"  # each has two rows
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


def test_check_tables_and_help_in_the_menu(captures):
    """Windows stay open: with Qt 6.8 Wireshark crashes at times when Lua opens one after another was closed."""
    with gui.Wireshark("-r", captures / "first.pcapng") as wireshark:
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Check")
        wireshark.answer("YAPP Check", "fault=0,motor.count=60")
        text_of(wireshark, "YAPP Check", "FAILED  fault=0")
        for name in model.IN_TEXT:  # a row is one line of a window as it opens, but for texts of events
            wireshark.wait_for_window("first.pcapng")
            choose(wireshark, TITLES[name])
            if name == "fault":
                wireshark.answer("YAPP Fault", "1")
            text = text_of(wireshark, f"YAPP {TITLES[name]}", f"YAPP {name}:").split("\n\n", 1)[1]  # behind the notes
            assert max(map(len, text.splitlines())) <= {"events": 95, "fault": 110, "compare": 80}.get(name, 73), name
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Export tables")
        wireshark.answer("YAPP Export tables", str(captures / "tables"))
        text_of(wireshark, "YAPP Export tables", "motor.csv")
        assert (captures / "tables/motor.csv").read_text().count("\n") == 236
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Help")
        text_of(wireshark, "YAPP Help", "taurus.fault.active")
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


# Collects garbage at each packet, and counts the taps that there are; into the file of its name.
LEFT = """
local out, new, alive = "%s", Listener.new, 0
local function count(change)
  alive = alive + change
  local file = io.open(out, "w")
  file:write(alive)
  file:close()
end
local garbage = new("frame")
function garbage.packet() collectgarbage() end
rawset(Listener, "new", function(...) -- the class is shared, the globals of scripts are not
  local tap = new(...)
  count(1)
  return setmetatable({ remove = function()
    tap:remove()
    count(-1)
  end }, { __newindex = function(_, key, value) tap[key] = value end })
end)
"""


def test_what_stays_and_what_goes(captures):
    """A window without buttons stays when Lua collects garbage; a statistic's taps go when it is done."""
    alive, script, path = captures / "alive", captures / "left.lua", captures / "first.pcapng"
    script.write_text(LEFT % alive)
    with gui.Wireshark("-X", f"lua_script:{script}", "-r", path) as wireshark:
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Help")
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Summary")
        text_of(wireshark, "YAPP Summary", "Motor Data")
        assert alive.read_text() == "0"
        wireshark.wait_for_window("YAPP Help")
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


def test_an_open_window_follows_a_live_capture(captures):
    """By itself, once packets have come; each counts once, although more come while it reads."""
    fifo, path = captures / "live", captures / "first.pcapng"
    os.mkfifo(fifo, 0o666)
    os.chmod(fifo, 0o666)
    data = path.read_bytes()
    parts = [data[at:at + 3000] for at in range(0, len(data), 3000)]

    def feed():
        with open(fifo, "wb", buffering=0) as file:
            for part in parts:
                file.write(part)
                time.sleep(0.3)
            time.sleep(20)

    threading.Thread(target=feed, daemon=True).start()
    with gui.Wireshark("-o", "statistics.update_interval:1000", "-k", "-i", fifo) as wireshark:
        wireshark.wait_for_window("Capturing")
        choose(wireshark, "Summary")
        text_of(wireshark, "YAPP Summary", "YAPP summary")
        text = text_of(wireshark, "YAPP Summary", "in 11.9")
        assert "went back" not in text and re.search(r"0x210 +Motor Data +120 ", text), text
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


def test_unknown_ids_are_decoded_and_the_way_back(captures):
    with gui.Wireshark("-o", "yapp.motor_ids:0x300", "-r", captures / "first.pcapng") as wireshark:
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Faults")
        text = text_of(wireshark, "YAPP Faults", "YAPP faults")
        assert "YAPP faults: UNKNOWN, 2 of 6 sources not decoded, 0 in what was decoded\n" in text
        assert "Tools > YAPP > Decode unknown IDs by size decodes them" in text and "-o yapp" not in text
        wireshark.keys("Escape")
        wireshark.wait_for_window("first.pcapng")
        choose(wireshark, "Decode unknown IDs by size")
        text = text_of(wireshark, "YAPP Decode", "yapp.motor_ids")
        assert "yapp.motor_ids was 0x300, and is now\n  0x210,0x300\n" in text, text
        wireshark.click("Undo")
        text_of(wireshark, "YAPP Decode", "The preferences are as they were")


def test_a_statistic_after_lua_plugins_were_reloaded(captures):
    """The buses stay, by Wireshark's fields; a fault on each of the two is found; what the file says of losses is gone."""
    probe = Probe(captures)
    with gui.Wireshark("-X", f"lua_script:{probe.script}", "-r", gui.FLIGHT) as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        choose(wireshark, "Faults")
        before = text_of(wireshark, "YAPP Faults", "YAPP faults")
        wireshark.keys("Escape")
        wireshark.wait_for_window("flight.pcapng")
        probe.forget()
        wireshark.press("ctrl+shift+l", until=probe.path.exists)
        wireshark.wait_for_window("flight.pcapng")
        choose(wireshark, "Faults")
        after = text_of(wireshark, "YAPP Faults", "YAPP faults")
        said = "Lua plugins were reloaded"
        assert said not in before and said in after, after
        assert [line for line in after.splitlines() if said not in line] == before.splitlines(), after
        assert "can1" in after
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


def test_another_reading_in_the_middle(captures):
    """Wireshark resets all taps for the second one, and refuses it: the first one's answer has all packets."""
    script = captures / "second.lua"
    script.write_text("""
local tap, count, is_busy = Listener.new("frame"), 0, false
function tap.packet(pinfo)
  count = count + 1
  if count > 1500 and pinfo.number == 500 and not is_busy then
    is_busy = true
    retap_packets()
    is_busy = false
  end
end
""")
    with gui.Wireshark("-X", f"lua_script:{script}", "-r", gui.FLIGHT) as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        choose(wireshark, "Faults")
        text = text_of(wireshark, "YAPP Faults", "YAPP faults")
        assert "YAPP faults: 1" in text and "motor_overcurrent" in text and "only" not in text
