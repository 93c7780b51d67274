# SPDX-License-Identifier: GPL-2.0-or-later
"""yt.read: types, reserved counts, events, refusals; with a stand-in for tshark."""

import json

import pyarrow as pa
import pytest
import yapp_tables as yt
from running import FAKE, motor_row


def read(path, **options):
    return yt.read(path, tshark=FAKE, **options)


def test_a_message_is_a_table_with_the_promised_types(make_capture):
    motor = read(make_capture("flight.pcapng", motor=[motor_row(0), motor_row(1)]))["motor"]
    assert motor.schema.names == [
        "time", "source_file", "bus", "frame", "source", "controller", "id", "seq", "flight_id",
        "rpm_measured", "rpm_measured_special",
        "motor_mode", "motor_mode_text", "fault_flags", "fault_motor_overcurrent", "timestamp", "serial", "revision",
    ]  # fmt: skip
    assert motor.schema.field("time").type == pa.timestamp("ns", tz="UTC")
    assert motor.schema.field("rpm_measured").type == pa.float64()
    assert motor.schema.field("motor_mode").type == pa.uint8()
    assert motor.schema.field("fault_motor_overcurrent").type == pa.bool_()
    assert motor["time"].cast(pa.int64()).to_pylist() == [1_700_000_000_000_000_001, 1_700_000_000_100_000_001]
    assert motor["source_file"].to_pylist() == ["flight.pcapng"] * 2
    assert motor["source"].null_count == 2
    assert motor["motor_mode_text"].to_pylist() == ["Speed Mode"] * 2
    assert motor["serial"].to_pylist() == [2**64 - 1] * 2
    assert motor.schema.field("revision").type == pa.uint8()
    assert motor.schema.field("rpm_measured").metadata == {
        b"title": b"Measured speed", b"unit": b"RPM", b"filter": b"taurus.motor.rpm",
        b"role": b"value",
    }  # fmt: skip


def test_reserved_values_are_null_and_named(make_capture):
    names = ["nan", "inf", "-inf", "above", "below", ""]
    rows = [motor_row(n, rpm_measured="" if name else "7.5", rpm_measured_special=name) for n, name in enumerate(names)]
    motor = read(make_capture("flight.pcapng", motor=rows))["motor"]
    assert motor["rpm_measured"].to_pylist() == [None] * 5 + [7.5]
    assert motor["rpm_measured_special"].to_pylist() == [*names[:5], None]


def test_text_keeps_commas_quotes_and_lines(make_capture):
    row = motor_row(0, text='"a, ""b""\nnan"')
    assert read(make_capture("flight.pcapng", note=[row]))["note"]["text"].to_pylist() == ['a, "b"\nnan']


def test_events_faults_and_summary(make_capture):
    head = {"time": 1700000001.500000001, "frame": 80, "bus": "can0", "id": 528, "source": None}
    fault = head | {"kind": "fault", "message": "motor", "field": "fault_flags", "flag": "motor_overcurrent"}
    events = [fault | {"event": "raised", "active": None}, head | {"kind": "silence", "length": 3.25}]
    source = {
        "bus": "can0",
        "id": 528,
        "source": "left",
        "message": "motor",
        "count": 2,
        "rate": 10.0,
        "new_key": [1.5],
    }
    flight = read(make_capture("flight.pcapng", motor=[motor_row(0)], events=events, summary=[source]))
    assert flight.events["kind"].to_pylist() == ["fault", "silence"]
    assert flight.events["length"].to_pylist() == [None, 3.25]
    assert flight.faults["flag"].to_pylist() == ["motor_overcurrent"]
    assert flight.summary["rate"].to_pylist() == [10.0]
    assert flight.summary["controller"].to_pylist() == ["left"]
    assert json.loads(flight.summary["other"][0].as_py()) == {"new_key": [1.5]}


def test_words_that_do_not_exist_are_answered_by_those_that_do(make_capture):
    capture = make_capture("flight.pcapng", motor=[motor_row(0)])
    with pytest.raises(yt.MessageError, match="no message 'motr'; known messages: motor, note"):
        read(capture, messages=["motr"])
    with pytest.raises(yt.MessageError, match=r"no column 'nope' in motor; known columns: time, .*rpm_measured"):
        read(capture, messages=["motor"], columns=["nope"])
    with pytest.raises(TypeError, match="optionz"):
        read(capture, optionz=["x"])
    with pytest.raises(yt.SetupError, match="no kind 'parket'; known kinds: parquet"):
        yt.convert(capture, "out", to="parket", tshark=FAKE)
    # A message that the catalogue has, and this capture has not.
    with pytest.raises(yt.MessageError, match="has no decoded Note"):
        read(capture, messages=["motor", "note"])["note"]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [({"does": ["refuse"]}, "isn't a capture file"), ({}, "no YAPP messages"), ({"does": ["crash"]}, "signal 11")],
)
def test_what_cannot_be_read_is_a_sentence(make_capture, content, sentence):
    with pytest.raises(yt.YappError, match=sentence):
        read(make_capture("flight.pcapng", **content))


def test_no_capture_no_tshark_no_plugin(make_capture, tmp_path, monkeypatch):
    flight = make_capture("flight.pcapng", motor=[motor_row(0)])
    with pytest.raises(yt.CaptureError, match="no such file"):
        read(tmp_path / "none.pcapng")
    with pytest.raises(yt.SetupError, match="no program"):
        yt.read(flight, tshark="no-such-tshark")
    with pytest.raises(yt.SetupError, match=r"no plugin at .*none\.lua"):
        read(flight, plugin="none.lua")
    monkeypatch.setenv("FAKE_PLUGIN", "none")
    with pytest.raises(yt.SetupError, match="no YAPP plugin"):
        read(flight)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(yt.SetupError, match="tshark was not found"):
        yt.read(flight)
