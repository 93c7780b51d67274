# SPDX-License-Identifier: GPL-2.0-or-later
"""Nothing is left out in silence: undecoded messages in read, convert and report; with a stand-in for tshark."""

import re

import pytest
import yapp_tables as yt
from running import FAKE, motor_row

AT = {"time": 1700000000.000000001, "frame": 3, "bus": "can0", "source": None, "message": None}
SENTENCE = "648 messages were not decoded: can0 0x211, 0x212, 0x213 (32 bytes). Try -o yapp.motor_ids:0x210-0x213"


def unknown(number, count=216, **more):
    return AT | {"kind": "unknown", "id": number, "size": 32, "count": count, "like": "motor"} | more


def source(number, message="motor"):
    return AT | {"id": number, "message": message, "count": 1}


SAYS = f"yapp: {SENTENCE}"
EVENTS = [unknown(0x211), unknown(0x212), unknown(0x213)]
SUMMARY = [source(0x210), source(0x200, "note"), *(source(number, None) for number in (0x211, 0x212, 0x213))]


@pytest.fixture
def capture(make_capture):
    return make_capture("flight.pcapng", motor=[motor_row(0)], events=EVENTS, summary=SUMMARY, says=SAYS)


def test_read_warns(capture):
    with pytest.warns(UserWarning, match=re.escape(SENTENCE)):
        flight = yt.read(capture, tshark=FAKE)
    assert flight.left_out == [SENTENCE]
    with pytest.raises(KeyError) as missing:
        flight["note"]
    assert missing.value.args == (f"flight.pcapng has no decoded Note: {SENTENCE}",)
    assert flight.get("note") is None
    with pytest.raises(KeyError, match=r"no message 'moter'; known messages: motor, note"):
        flight["moter"]


def test_convert_says_it_each_time_and_does_not_end_with_0(capture, yapp_tables):
    command = ["convert", capture, "--to", "parquet", "--out", "data"]
    for _ in range(2):  # the second time the result is up to date
        done = yapp_tables(*command)
        assert done.returncode == 3
        assert f"flight.pcapng: {SENTENCE}" in done.stderr
        assert "1 of 1 capture not decoded completely" in done.stderr.splitlines()[-1]


def test_report_says_it_first(capture, yapp_tables, tmp_path):
    done = yapp_tables("report", capture)
    assert done.returncode == 3
    assert SENTENCE in done.stderr
    page = re.sub("<.*?>", "", (tmp_path / "flight.html").read_text().partition("<body>")[2])
    assert "UNKNOWN: no fault, reboot or silence in what was decoded; not all decoded." in page
    assert page.index("UNKNOWN") < page.index(SENTENCE) < page.index("Controllers compared")


def test_a_capture_without_a_decoded_message(make_capture, yapp_tables):
    path = make_capture("flight.pcapng", events=EVENTS, summary=SUMMARY[2:], says=SAYS)
    with pytest.raises(yt.CaptureError, match="no YAPP messages in it: 648 messages were not"):
        yt.read(path, tshark=FAKE)
    for command in (["report", path], ["convert", path, "--to", "csv", "--out", "data"]):
        done = yapp_tables(*command)
        assert done.returncode == 1
        assert "Try -o yapp.motor_ids:0x210-0x213" in done.stderr


COPIED = "120 messages were recorded twice; each counts once"


def test_copies_leave_nothing_out(make_capture, yapp_tables, tmp_path):
    path = make_capture("flight.pcapng", motor=[motor_row(0)], summary=SUMMARY[:1], says=f"yapp: {COPIED}")
    for _ in range(2):  # the second time the result is up to date
        done = yapp_tables("convert", path, "--to", "csv", "--out", "data")
        assert (done.returncode, f"flight.pcapng: {COPIED}" in done.stderr) == (0, True)
    flights = (next((tmp_path / "data/message=flights").iterdir())).read_text()
    assert COPIED in flights
    flight = yt.read(path, tshark=FAKE)
    assert (flight.left_out, list(flight.notes)) == ([], [COPIED])
    yapp_tables("report", path, code=0)
