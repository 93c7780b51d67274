# SPDX-License-Identifier: GPL-2.0-or-later
"""The tests' own way to run tshark sees what goes wrong in Lua, whatever is asked for: exit code 0 proves nothing."""
import levels
import pytest
import tshark

pytestmark = levels.by_route
CAPTURE = tshark.CAPTURES / "can/document_motor.pcap"
PLANTED = """
local planted = Proto("planted", "Planted")
function planted.dissector(_, pinfo) if pinfo.number == 3 then error("planted") end end
register_postdissector(planted)
"""


@pytest.fixture
def load(folder):
    (folder / "planted.lua").write_text(PLANTED)
    return tshark.load(folder / "planted.lua")


@pytest.mark.parametrize("arguments", [(), ("-2",), ("-2", "-Y", "frame.number == 1"), ("-Y", "udp")], ids=" ".join)
def test_an_error_in_a_frame_is_seen_among_its_fields(arguments, load):
    with pytest.raises(AssertionError, match="Lua error"):
        tshark.fields(CAPTURE, ["frame.number"], *load, *arguments)


@pytest.mark.parametrize("arguments", [("-V",), ("-T", "pdml"), ("-q", "-z", "expert")], ids=" ".join)
def test_an_error_in_a_frame_is_seen_in_trees_and_lists(arguments, load):
    with pytest.raises(AssertionError, match="Lua Error: .*planted"):
        tshark.run("-r", CAPTURE, *load, *arguments)


def test_an_error_in_a_frame_is_seen_where_filters_are_counted(load):
    tshark.assert_found(CAPTURE, [("frame.number > 3", [4, 5])])
    with pytest.raises(AssertionError, match="'2', 1"):
        tshark.assert_found(CAPTURE, [("frame.number > 3", [5])])
    with pytest.raises(AssertionError, match=tshark.LUA_ERROR):
        tshark.assert_found(CAPTURE, [("frame.number > 3", [4, 5])], *load)


def test_an_error_in_a_frame_is_seen_where_nothing_else_is_asked(load):
    tshark.assert_no_lua_errors(CAPTURE)
    with pytest.raises(AssertionError, match=r"frames \['3'\]"):
        tshark.assert_no_lua_errors(CAPTURE, *load)


def test_an_exit_code_and_an_empty_answer_are_seen(folder):
    (folder / "empty.pcap").write_bytes(CAPTURE.read_bytes()[:24])
    with pytest.raises(AssertionError, match="no_such"):
        tshark.run("-r", folder / "no_such.pcap")
    with pytest.raises(AssertionError, match="read no packet"):
        tshark.fields(folder / "empty.pcap", ["frame.number"])
    with pytest.raises(AssertionError, match="nothing to find"):
        tshark.assert_found(CAPTURE, [])


def test_an_error_at_load_is_seen(folder):
    (folder / "planted.lua").write_text("error('planted')")
    with pytest.raises(AssertionError, match="Lua:"):
        tshark.run("-r", CAPTURE, *tshark.load(folder / "planted.lua"))
