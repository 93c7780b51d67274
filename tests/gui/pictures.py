# SPDX-License-Identifier: GPL-2.0-or-later
"""The pictures of README.md and docs/fault.md: the profile YAPP on docs/flight.pcapng.  pictures.py FOLDER"""
import pathlib
import sys
import time

import gui

NAMES = "can0/0x210=motor:left, can1/0x210=motor:right"
RAISED = "719"  # the frame
LIST = (300, 150)  # a place in the packet list


def go_to(wireshark, frame):
    """Chooses a frame by Wireshark's own Go to Packet."""
    wireshark.keys("ctrl+g", "ctrl+a")
    wireshark.type(frame)
    wireshark.keys("Return")
    time.sleep(1)


def without_pointer(wireshark):
    wireshark.xdotool("mousemove", gui.WIDTH - 1, gui.HEIGHT - 1)
    time.sleep(0.5)


def tree(wireshark, *open_nodes):
    """Goes to the tree's Taurus part, which is its last."""
    wireshark.xdotool("mousemove", gui.WIDTH // 2, gui.HEIGHT - 60, "click", "1")
    wireshark.keys("End", "Left", "Right")
    without_pointer(wireshark)


def whole_window(wireshark, folder):
    wireshark.filter("taurus.motor")
    go_to(wireshark, RAISED)
    tree(wireshark)
    wireshark.picture(folder / "wireshark.png")


def buttons(wireshark, folder):
    wireshark.filter("")
    wireshark.xdotool("mousemove", gui.WIDTH - 60, 57, "click", "1")
    time.sleep(1)
    wireshark.keys("Down", "Right", "Down")
    time.sleep(1)
    wireshark.picture(folder / "fault_buttons.png", f"{gui.WIDTH}x330+0+0")
    wireshark.keys("Escape", "Escape")


def transition(wireshark, folder):
    wireshark.filter("taurus.fault.raised || taurus.fault.cleared")
    wireshark.keys("ctrl+Home")
    tree(wireshark)
    wireshark.keys("End")
    wireshark.picture(folder / "fault_tree.png")


def window(wireshark, title, path, size):
    """A picture of a window of this size."""
    found = wireshark.wait_for_window(title)
    wireshark.xdotool("windowsize", "--sync", found, *size)
    without_pointer(wireshark)
    wireshark.picture(path, window=found)
    wireshark.keys("Escape")


def events(wireshark, folder):
    wireshark.press("alt+t", "Up", "Right", "Down", "Return",  # Tools, YAPP, Events
                    until=lambda: any("YAPP Events" in title for title in wireshark.windows().values()))
    window(wireshark, "YAPP Events", folder / "fault_events.png", (1090, 260))


def graph(wireshark, folder):
    wireshark.filter("")
    wireshark.press("alt+s", "i", until=lambda: any("I/O Graphs" in title for title in wireshark.windows().values()))
    window(wireshark, "I/O Graphs", folder / "fault_graph.png", (900, 560))


def main(folder):
    with gui.Wireshark("-C", "YAPP", "-o", f"yapp.sources:{NAMES}", "-r", gui.FLIGHT,
                       profile=gui.ROOT / "profiles/YAPP") as wireshark:
        wireshark.wait_for_window("flight.pcapng")
        time.sleep(2)
        for picture in (whole_window, buttons, transition, events, graph):
            picture(wireshark, folder)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
