# SPDX-License-Identifier: GPL-2.0-or-later
"""What the user may set: preferences, the catalogue, where the plugin is installed.  Nonsense gets a clear message."""
import pathlib
import sys

import pytest

import levels
import model
import tshark

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test_captures"))
import expected  # noqa: E402
import make  # noqa: E402

pytestmark = levels.by_route
MOTOR = "FD 7F FD 7F FD 7F FD 7F F5 AF FD 7F 18 01 00 00 01 40 00 00 00 00 E3 8C D2 3C E0 4E 00 00 05 FF"
HEALTH = "00 CA 9A 3B 00 00 00 00 7D 32 5A 46 50 19 64 01 03"


def write(folder, *lines):
    """A capture made of lines as in a .frames file."""
    path = folder / "capture.pcap"
    path.write_bytes(make.pcap(make.Source("\n".join(lines))))
    return path


# Of Motor Data, which comes every 0.1 s: a preference, and the frames that are late by it.
LATE = [([], [4]), (["-o", "yapp.late:2"], [3, 4]), (["-o", "yapp.late:2.6"], []), (["-o", "yapp.late:soon"], [4])]


@pytest.mark.parametrize("setting, frames", LATE)
def test_late(folder, setting, frames):
    """A gap of exactly so many periods is none that is late."""
    path = write(folder, *(f"{time} can0 fd [210 {MOTOR}]" for time in ("1.0", "1.2", "1.45", "1.700001")))
    tshark.assert_found(path, [("yapp.late", frames)], *setting)


# The divisor of compressed floats --------------------------------------------------------------------------------

@pytest.mark.parametrize("choice, divisor, current, speed", [
    ("2^N - 6 (mapping)", model.MAPPING, "0.5005", "750.80"),
    ("2^N - 5 (worked examples)", model.WORKED_EXAMPLES, "0.4975", "749.26")])
def test_divisor(choice, divisor, current, speed):
    frame, = expected.shown(make.capture("document_command")[0], "-o", f"yapp.divisor:{choice}")
    assert f"{float(frame['taurus.command.torque_iq'][0]):.4f}" == current
    assert f"{float(frame['taurus.command.rpm'][0]):.2f}" == speed
    health, = expected.shown(make.capture("fd_single")[0], "-Y", "taurus.health", "-o", f"yapp.divisor:{choice}")
    wanted = model.decode(model.HEALTH, bytes.fromhex(HEALTH), divisor)[0]
    assert {name: health[name] for name in wanted} == {name: [value] for name, value in wanted.items()}


# What Info leaves out --------------------------------------------------------------------------------------------

@levels.each_once
@pytest.mark.parametrize("hides_source, name", [("FALSE", " left"), ("TRUE", "")])
@pytest.mark.parametrize("hides_values, values", [
    ("TRUE", "ESC 25 °C  0.00 A torque"), ("FALSE", "0.0/0.0 RPM  47.97 V  0.00 A")])
def test_what_columns_show_is_left_out_of_info(folder, hides_source, name, hides_values, values):
    """Of a message with nothing to remark."""
    path = write(folder, f"can0 fd [210 {MOTOR.removesuffix('FF')}41]")
    shown = tshark.fields(path, [expected.column("Info")], "-o", "yapp.sources:0x210=motor:left", "-o",
                          f"yapp.hide_source:{hides_source}", "-o", f"yapp.hide_values:{hides_values}")
    assert shown == [[f"Motor Data{name}  {values}"]]


# Which IDs carry which message -----------------------------------------------------------------------------------

def messages(frames):
    """{frame: title of the message that is decoded there}."""
    titles = {f"taurus.{name}": title for name, title, _ in model.MESSAGES.values()}
    return {frame["frame"]: title for frame in frames for name, title in titles.items() if name in frame}


def test_message_ids(folder):
    path = write(folder, f"can0 fd [210 {MOTOR}]", f"can0 fd [211 {MOTOR}]", f"can0 [211 {MOTOR}]",
                 f"can0 fd [300 {HEALTH}]", f"can0 fd [303 {HEALTH}]", "can0 [7FF 01 5A 01 4F 80 F3 80]",
                 "can0 [0 01 5A 01 4F 80 F3 80]")
    assert messages(expected.shown(path)) == {1: "Motor Data", 11: "Command"}
    chosen = ["-o", "yapp.motor_ids:0x210,0x211", "-o", "yapp.health_ids:0x200,0x300-0x303", "-o",
              "yapp.command_ids:0x7ff"]
    for passes in levels.size([("-2",)], expected.PASSES.values()):
        frames = expected.shown(path, *passes, *chosen)
        assert messages(frames) == {1: "Motor Data", 2: "Motor Data", 7: "Motor Data", 8: "Health", 9: "Health",
                                    10: "Command"}
        assert 11 not in [frame["frame"] for frame in frames]
    tree = tshark.run("-r", path, "-V", *chosen).stdout
    for title in ("Motor Data (0x00000211)", "Health (0x00000300)", "Command (0x000007ff)"):
        assert f"Message ID: {title}" in tree


# Other preferences -----------------------------------------------------------------------------------------------

def test_all_extended():
    path = make.capture("unknown_id")[0]
    assert [frame["frame"] for frame in expected.shown(path)] == [2, 3, 4, 5]
    assert [frame["frame"] for frame in expected.shown(path, "-o", "yapp.all_extended:TRUE")] == [1, 2, 3, 4, 5]


@levels.each_once
@pytest.mark.parametrize("choice", ["", "147", "148-162", "150,147"])
@pytest.mark.parametrize("passes", expected.PASSES)
def test_user_dlt(choice, passes):
    path = make.capture("document_uart_dlt_user0")[0]
    passes = passes if "147" in choice else passes.removesuffix(" -Y")  # with a filter nothing is what is to be shown
    assert messages(expected.shown(path, *expected.PASSES[passes], "-o", f"yapp.user_dlt:{choice}")) == (
        {1: "Motor Data"} if "147" in choice else {})


@pytest.mark.parametrize("setting, said", [
    ("sources:0x210=moter:left", 'yapp.sources: no message "moter" in "0x210=moter:left"; known messages: ' +
     ", ".join(message[0] for message in model.MESSAGES.values())),
    ("late:soon", 'yapp.late: no number above 0 in "soon"; it is 2.5 until you change it'),
    ("user_dlt:1,147", "yapp.user_dlt: link type 1 is no DLT_USER; those are 147 to 162"),
    ("command_ids:0x210", "ID 0x210 is given to Command and to Motor Data: it stays with Command")])
def test_what_cannot_be_read_is_said_and_is_never_well(setting, said):
    done = tshark.run("-q", "-r", tshark.CAPTURES / "cases/g0_clean.pcapng", "-o", f"yapp.{setting}", "-z", "yapp,check,fault=0",
                      check=False)
    assert done.returncode == (20 if "ids" in setting else 21)  # what is no Motor Data any more is unknown
    assert f"yapp: preferences: {said}\n" in done.stderr and done.stderr.count(said) == 1 and f"preferences: {said}" in done.stdout
