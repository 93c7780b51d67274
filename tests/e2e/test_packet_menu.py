# SPDX-License-Identifier: GPL-2.0-or-later
"""Items of the menu of a packet, which only Wireshark's windows have: what they hand to them."""
import pathlib

import levels
import tshark

SCRIPT = pathlib.Path(__file__).with_name("packet_menu.lua")
LOG = """(1700000000.000001) can0 08404000#BBBE6FC720000000
(1700000000.000002) can0 123#1122
(1700000000.000003) can0 007#
(1700000000.000004) can0 00000123#11
(1700000000.000005) can0 08404000#R
(1700000000.000006) can0 08404000#R8
(1700000000.000007) can0 123#R1
(1700000000.000008) can0 08404000##1112233445566778899AABBCC
"""


def menu(capture, *arguments, asked="-"):
    return tshark.run("-X", f"lua_script:{SCRIPT}", "-q", "-r", capture, *arguments, env={"YAPP_MENU": asked}).stdout


@levels.by_version
def test_copy_as_candump(tmp_path):
    """The lines of the log that was opened; those of a capture whose ids have the other byte order."""
    path = tmp_path / "run.log"
    path.write_text(LOG)
    copy = "-z", "yappmenu,copy"
    assert menu(path, *copy, "-X", "read_format:yapp_candump") == LOG
    lines = menu(tshark.CAPTURES / "remote_frames.pcap", *copy).splitlines()
    assert [line.split()[2] for line in lines] == [
        "08404000#BBBE6FC720000000", "08404000#R", "08408000#FD7FFD7FFD7FFD7F", "08408000#R8", "08408000#F5AFFD7F18010000",
        "08408000#R8", "08408000#014000000000E38C", "0840C000#R8", "00000000#R7", "0840C000#D23CE04E000005FF"]
