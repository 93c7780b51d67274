# SPDX-License-Identifier: GPL-2.0-or-later
"""Items of the menu of a packet, which only Wireshark's windows have: what they hand to them."""
import pathlib

import tshark

SCRIPT = pathlib.Path(__file__).with_name("packet_menu.lua")


def test_items_on_faults_need_a_message_with_faults():
    """On an ID that is not decoded they would filter to nothing."""
    done = tshark.run("-X", f"lua_script:{SCRIPT}", "-q", "-r", tshark.CAPTURES / "can/document_motor.pcap", "-z", "yappmenu")
    needs = dict(line.rsplit("=", 1) for line in done.stdout.splitlines())
    faults = {title for title in needs if "fault" in title.lower()} - {"YAPP/Fault"}
    assert len(faults) == 3
    assert {needs[title] for title in faults} == {"taurus.motor.fault_flags"}
    assert needs["YAPP/Only this controller"] == "yapp.source"
