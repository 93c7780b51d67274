# SPDX-License-Identifier: GPL-2.0-or-later
"""Items of the menu of a packet, which only Wireshark's windows have: what they hand to them."""
import pathlib

import tshark

SCRIPT = pathlib.Path(__file__).with_name("packet_menu.lua")
# The bus of a controller 0x210, the preference yapp.sources, and what is shown of it
NAMES = [
    ("can1", "", "can1/0x210="),
    ("can1", "can1/0x210=left", "can1/0x210=left"),
    ("can1", "can1/0x210 = left", "can1/0x210 = left"),
    ("", "can1/0x210=left", "can1/0x210=left, 0x210="),
    ("an1", "can1/0x210=left", "can1/0x210=left, an1/0x210="),
    ("", "0x210+0x211=motor:left", "0x210+0x211=motor:left"),
    ("192.168.1.12:40000", "", "192.168.1.12:40000/0x210="),
    ("192.168.1.12:40000", "192.168.1.12/0x210=left", "192.168.1.12/0x210=left"),  # any port
    ("192.168.1.12:40000", "192.168.1.13/0x210=left", "192.168.1.13/0x210=left, 192.168.1.12:40000/0x210="),
    ("[fe80::1]:14550", "", "[fe80::1]:14550/0x210="),
    ("ttyS0#rx", "ttyS0/0x210=left", "ttyS0/0x210=left"),
    ("usb1.6.1#rx", "", "usb1.6.1#rx/0x210="),
]


def menu(capture, *arguments, asked="-"):
    return tshark.run("-X", f"lua_script:{SCRIPT}", "-q", "-r", capture, *arguments, env={"YAPP_MENU": asked}).stdout


def test_items_on_faults_need_a_message_with_faults():
    """On an ID that is not decoded they would filter to nothing."""
    needs = dict(line.rsplit("=", 1) for line in menu(tshark.CAPTURES / "can/document_motor.pcap", "-z", "yappmenu,needs").splitlines())
    faults = {title for title in needs if "fault" in title.lower()} - {"YAPP/Fault"}
    assert len(faults) == 3
    assert {needs[title] for title in faults} == {"taurus.motor.fault_flags"}
    assert needs["YAPP/Only this controller"] == "yapp.source"


def test_name_this_controller():
    """A part that names the controller stays; otherwise one is added."""
    asked = "\n".join(f"{bus}|{sources}" for bus, sources, _ in NAMES)
    shown = menu(tshark.CAPTURES / "can/document_motor.pcap", asked=asked)
    assert shown.splitlines() == [expected for _, _, expected in NAMES]
