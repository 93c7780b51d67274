# SPDX-License-Identifier: GPL-2.0-or-later
"""yt.read: types, reserved counts, events, refusals; with a stand-in for tshark."""

import pytest
import yapp_tables as yt
from running import FAKE, motor_row


def read(path, **options):
    return yt.read(path, tshark=FAKE, **options)


def test_text_keeps_commas_quotes_and_lines(make_capture):
    row = motor_row(0, text='"a, ""b""\nnan"')
    assert read(make_capture("flight.pcapng", note=[row]))["note"]["text"].to_pylist() == ['a, "b"\nnan']


def test_words_that_do_not_exist_are_answered_by_those_that_do(make_capture):
    capture = make_capture("flight.pcapng", motor=[motor_row(0)])
    with pytest.raises(TypeError, match="optionz"):
        read(capture, optionz=["x"])


@pytest.mark.parametrize(
    ("content", "sentence"),
    [({"does": ["refuse"]}, "isn't a capture file"), ({}, "no YAPP messages"), ({"does": ["crash"]}, "signal 11")],
)
def test_what_cannot_be_read_is_a_sentence(make_capture, content, sentence):
    with pytest.raises(yt.YappError, match=sentence):
        read(make_capture("flight.pcapng", **content))


def test_no_tshark_no_plugin(make_capture, tmp_path, monkeypatch):
    flight = make_capture("flight.pcapng", motor=[motor_row(0)])
    with pytest.raises(yt.SetupError, match="no program"):
        yt.read(flight, tshark="no-such-tshark")
    monkeypatch.setenv("FAKE_PLUGIN", "none")
    with pytest.raises(yt.SetupError, match="no YAPP plugin"):
        read(flight)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(yt.SetupError, match="tshark was not found"):
        yt.read(flight)
