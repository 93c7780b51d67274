# SPDX-License-Identifier: GPL-2.0-or-later
"""The pictures of README.md and docs/fault.md: the profile YAPP on docs/flight.pcapng, in Wireshark 4.6, where a mouse knows the
places.  pictures.py FOLDER"""
import pathlib
import shutil
import sys
import tempfile
import time

import gui

NAMES = "can0/0x210=motor:left, can1/0x210=motor:right"
RAISED, LATER = "719", "756"  # frames
LAYOUT = ["gui.layout_type:1", "gui.layout_content_2:PDETAILS", "gui.layout_content_3:NONE"]


def profile(folder):
    """The profile YAPP, with the graphs of one motor."""
    path = folder / "YAPP"
    shutil.copytree(gui.ROOT / "profiles/YAPP", path)
    graphs = path / "io_graphs"
    graphs.write_text(graphs.read_text().replace('"!yapp.crc.bad"', r'"yapp.source == \x22right\x22"'))
    recent = path / "recent"
    recent.write_text(recent.read_text().replace("yapp.source, 165", "yapp.source, 80").replace("%t, 110", "%t, 90"))
    return path


def show(wireshark, text):
    """Applies a display filter; the list of completions goes."""
    wireshark.keys("ctrl+slash", "ctrl+a", "BackSpace")
    wireshark.type(text)
    wireshark.keys("Escape", "Return")
    time.sleep(1)


def go_to(wireshark, frame):
    """Chooses a frame by Wireshark's own Go to Packet."""
    wireshark.keys("ctrl+g", "ctrl+a")
    wireshark.type(frame)
    wireshark.keys("Return")
    time.sleep(1)


def without_pointer(wireshark):
    wireshark.xdotool("mousemove", gui.WIDTH - 1, gui.HEIGHT - 1)
    time.sleep(0.5)


def open_tree(wireshark, *keys):
    """Opens the last part of the tree, and goes on with keys."""
    wireshark.xdotool("mousemove", gui.WIDTH // 2, gui.HEIGHT - 60, "click", "1")
    time.sleep(0.5)
    wireshark.keys("Down", "End", "Left", "Right", *keys)
    without_pointer(wireshark)


def whole_window(wireshark, folder):
    show(wireshark, "taurus.motor")
    for frame in (LATER, RAISED):  # both in the list
        go_to(wireshark, frame)
    open_tree(wireshark)
    wireshark.picture(folder / "wireshark.png")


def buttons(wireshark, folder):
    wireshark.xdotool("mousemove", gui.WIDTH - 60, 57, "click", "1")
    time.sleep(1)
    wireshark.keys(*["Down"] * 3, "Right", "Down")
    time.sleep(1)
    wireshark.picture(folder / "fault_buttons.png", f"{gui.WIDTH}x230+0+0")
    wireshark.keys("Escape", "Escape")


def transition(wireshark, folder):
    show(wireshark, "taurus.fault.raised || taurus.fault.cleared")
    wireshark.keys("Tab", "ctrl+Home")
    open_tree(wireshark, "Right")  # what is wrong, and its links: the tree is open from the picture before
    wireshark.picture(folder / "fault_tree.png")


def window(wireshark, title, path, size):
    """A picture of a window of this size."""
    found = wireshark.wait_for_window(title)
    wireshark.xdotool("windowsize", "--sync", found, *size)
    without_pointer(wireshark)
    wireshark.picture(path, window=found)
    wireshark.keys("Escape")


def events(wireshark, folder):
    wireshark.press("alt+t", "Up", "Right", *["Down"] * 4, "Return",  # Tools, YAPP, which is sorted: Events
                    until=lambda: any("YAPP Events" in title for title in wireshark.windows().values()))
    window(wireshark, "YAPP Events", folder / "fault_events.png", (760, 440))


def graph(wireshark, folder):
    show(wireshark, "")
    wireshark.press("alt+s", "i", until=lambda: any("I/O Graphs" in title for title in wireshark.windows().values()))
    wireshark.wait_for_window("I/O Graphs")
    wireshark.xdotool("mousemove", 766, 595, "click", "1")  # Interval
    time.sleep(1)
    wireshark.keys("Up", "Up", "Return")  # 200 ms
    window(wireshark, "I/O Graphs", folder / "fault_graph.png", (900, 560))


def main(folder):
    gui.HEIGHT = 620  # README's first screen has more than the picture
    recent = "gui.geometry_main_upper_pane: 210\n"
    options = [word for option in [*LAYOUT, f"yapp.sources:{NAMES}"] for word in ("-o", option)]
    with tempfile.TemporaryDirectory() as name, gui.Wireshark(
            "-C", "YAPP", *options, "-r", gui.FLIGHT, profile=profile(pathlib.Path(name)), recent=recent) as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        time.sleep(2)
        for picture in (graph, whole_window, buttons, transition, events):
            picture(wireshark, folder)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
