# SPDX-License-Identifier: GPL-2.0-or-later
"""The profile YAPP in Wireshark's windows: column names, colours, the group of filter buttons and the lines of the graphs
are read off the screen."""
import pathlib
import re
import shlex
import shutil
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import gui  # noqa: E402
from test_gui import text_of  # noqa: E402

pytestmark = pytest.mark.skipif(bool(gui.MISSING), reason=f"not installed: {', '.join(gui.MISSING)}")
PROFILE = gui.ROOT / "profiles/YAPP"
VERSION = gui.tshark.version()


@pytest.fixture
def capture():
    folder = gui.tshark.writable_folder()
    yield pathlib.Path(shutil.copy(gui.FLIGHT, folder / "flight.pcapng"))
    shutil.rmtree(folder, ignore_errors=True)


def wait_for_words(wireshark, words, area="", scale=300, seconds=120):
    """Waits until all of these can be read."""
    read = []

    def found():
        read[:] = [wireshark.words(area, scale).lower()]
        return all(word.lower() in read[0] for word in words)
    try:
        gui.wait_for(found, seconds)
    except AssertionError as error:
        raise AssertionError(f"not all of {words} in: {read[0]}") from error


def test_columns_buttons_colours(capture):
    """By the command of docs/fault.md."""
    command = re.search(r"^    wireshark (.*)", (gui.ROOT / "docs/fault.md").read_text(), re.MULTILINE)[1]
    words = [str(capture) if word == "docs/flight.pcapng" else word for word in shlex.split(command)]
    with gui.Wireshark(*words, "-Y", "taurus.motor.fault_flags > 0", profile=PROFILE) as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        wait_for_words(wireshark, ["Source", "RPM", "Voltage", "Current", "State", "Info", "FAULT"],
                       f"{gui.WIDTH}x80+0+60")
        wait_for_words(wireshark, ["right"])  # the name
        assert wireshark.pixels("#ffbe79") > 2000  # a fault is active
        width = 120
        wait_for_words(wireshark, ["YAPP"], f"{width}x30+{gui.WIDTH - width}+43")
        wireshark.xdotool("mousemove", gui.WIDTH - 60, 57, "click", "1")
        wait_for_words(wireshark, ["Messages only", "Not decoded", "Faults", "Wire", "Controllers", "Commands"])
        with pytest.raises(AssertionError, match="not all of"):
            wait_for_words(wireshark, ["Faults", "Telegrams"], seconds=3)


# The submenu YAPP of a packet's menu, which has what the packet has.
ITEMS = ["Only this controller", "Whole message", "Fault"]
from_4_4 = pytest.mark.skipif(VERSION < (4, 4), reason="from 4.4 on")


def choose(wireshark, frame, number, until):
    """Chooses an item of the submenu for a frame, which is then the only row; returns what comes of it."""
    wireshark.filter(f"frame.number == {frame}")
    wireshark.keys("Escape")
    wireshark.tree(f"Frame {frame}:")
    return wireshark.press(*["Down"] * 6, "Right", *["Down"] * number, "Return", until=until, menu_of=(200, 100))


@from_4_4
def test_menu_of_a_packet(capture):
    """An item that filters quotes any name of a controller."""
    source = r'yapp.source in {"a \\\"b"}'
    expected = [source, "yapp.reassembled.in in {908}"]
    sources = r'yapp.sources:can1/0x210=motor:a \"b'
    with gui.Wireshark("-C", "YAPP", "-o", sources, "-r", capture, profile=PROFILE) as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        for number, text in enumerate(expected):
            def is_shown():
                wireshark.clipboard("-i")
                wireshark.keys("ctrl+slash", "ctrl+a", "ctrl+c")
                return wireshark.clipboard() == text
            choose(wireshark, 908, number, is_shown)
        choose(wireshark, 717, ITEMS.index("Fault"),  # a fragment of 719
               lambda: any(title.endswith("YAPP Fault") for title in wireshark.windows().values()))
        text = text_of(wireshark, "YAPP Fault", "YAPP fault: 1 of 1")
        assert " 719 " in text and "motor_overcurrent" in text, text
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()


@from_4_4
def test_an_unknown_id_is_decoded_by_its_menu(capture):
    with gui.Wireshark("-C", "YAPP", "-o", "yapp.motor_ids:0x300", "-r", capture, profile=PROFILE) as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        preferences = wireshark.home / ".config/wireshark/profiles/YAPP/preferences"
        # Decode this ID is the first one.
        choose(wireshark, 719, 0, lambda: "yapp.motor_ids: 768,528\n" in preferences.read_text())
        wireshark.tree("Frame 719:", "Taurus Motor Data")
        assert "Lua" not in wireshark.stderr(), wireshark.stderr()
