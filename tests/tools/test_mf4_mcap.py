# SPDX-License-Identifier: GPL-2.0-or-later
"""MF4 and MCAP, read back by asammdf and mcap; with a stand-in for tshark."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest
from asammdf import MDF
from mcap.reader import make_reader
from running import motor_row, result

ROWS = [
    motor_row(0),
    motor_row(1, rpm_measured="", rpm_measured_special="inf"),
    motor_row(2, rpm_measured="", rpm_measured_special="above"),
    motor_row(3, motor_mode="", motor_mode_text=""),
    motor_row(4, bus="can1", id="529", fault_flags="65536", fault_motor_overcurrent="1"),
    motor_row(5, bus="", id="529", source="\"left, \"\"aft\"\"\""),
    motor_row(6, bus="", id="529", source="right <&> below"),
]  # fmt: skip
NOTES = [motor_row(0, text="short"), motor_row(1, text=""), motor_row(2, text="µ longer than the first")]


@pytest.fixture
def converted(make_capture, yapp_tables, tmp_path):
    def convert(to):
        capture = make_capture("flight.pcapng", motor=ROWS, note=NOTES)
        yapp_tables("convert", capture, "--to", to, "--out", "data", code=0)
        return result(tmp_path / "data", "flight", f".{to}")

    return convert


def test_mf4(converted):
    with MDF(converted("mf4")) as mdf:
        assert mdf.version == "4.10"
        assert mdf.header.start_time == datetime(2023, 11, 14, 22, 13, 20, tzinfo=UTC)
        names = [group.channel_group.acq_name for group in mdf.groups]
        assert names == [
            "motor can0 0x210", "motor can1 0x211", 'motor left, "aft"', "motor right <&> below", "note can0 0x210",
            "flights",
        ]  # fmt: skip
        speed = mdf.get("rpm_measured", group=0, ignore_invalidation_bits=True)
        assert speed.unit == "RPM"
        assert speed.timestamps.tolist() == pytest.approx([1e-9, 0.100000001, 0.200000001, 0.300000001], abs=1e-12)
        assert speed.samples[[0, 3]].tolist() == [1000.5, 1003.5]
        assert np.asarray(speed.invalidation_bits).tolist() == [False, True, True, False]
        assert mdf.get("timestamp", group=0).samples.tolist() == pytest.approx([0, 0.1, 0.2, 0.3], abs=1e-9)
        assert mdf.get("motor_mode", group=0).samples.tolist() == [b"Speed Mode"] * 3
        assert mdf.get("motor_mode", group=0, raw=True).samples.tolist() == [1, 1, 1]
        assert mdf.get("rpm_measured_special", group=0).samples.tolist() == [b"inf", b"above"]
        assert mdf.get("fault_motor_overcurrent", group=1).samples.tolist() == [1]
        assert mdf.get("serial", group=2).samples.tolist() == [2**64 - 1]
        assert mdf.get("revision", group=0).samples.dtype == np.uint8
        assert [text.decode() for text in mdf.get("text", group=4).samples] == ["short", "µ longer than the first"]


@pytest.mark.parametrize("name", ["can0 0x210", 'left, "aft"', "right <&> below"])
def test_mf4_channels_of_several_sources_are_found_by_name(converted, name):
    with MDF(converted("mf4")) as mdf:
        for found in (f"{name}.rpm_measured", f"motor {name}.rpm_measured"):
            assert mdf.get(found, ignore_invalidation_bits=True).unit == "RPM"
        assert len(mdf.get("note can0 0x210.frame")) == len(NOTES)


def test_mcap(converted):
    with converted("mcap").open("rb") as file:
        reader = make_reader(file)
        found = [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in reader.iter_messages()
        ]
        schemas = {
            schema.name: (schema.encoding, json.loads(schema.data)) for schema in reader.get_summary().schemas.values()
        }
        assert all(channel.schema_id for channel in reader.get_summary().channels.values())
    motor = [row for row in found if row[0].startswith("/motor")]
    assert [row[0] for row in motor] == ["/motor/can0/0x210"] * 4 + [
        "/motor/can1/0x211", '/motor/left, "aft"', "/motor/right <&> below",
    ]  # fmt: skip
    assert motor[0][1] == 1_700_000_000_000_000_001
    assert motor[0][2] == {
        "bus": "can0", "frame": 5, "id": 528, "seq": 0, "rpm_measured": 1000.5, "motor_mode": 1,
        "motor_mode_text": "Speed Mode",
               "fault_flags": 0, "fault_motor_overcurrent": False, "timestamp": 0.0, "serial": 2**64 - 1, "revision": 3,
    }  # fmt: skip
    assert "rpm_measured" not in motor[1][2]
    assert motor[1][2]["rpm_measured_special"] == "inf"
    assert "rpm_measured" not in motor[2][2]
    assert motor[2][2]["rpm_measured_special"] == "above"
    assert motor[5][2]["source"] == 'left, "aft"'
    encoding, schema = schemas["motor"]
    assert encoding == "jsonschema"
    assert schema["properties"]["rpm_measured"] == {
        "type": "number", "title": "Measured speed", "description": "Measured speed [RPM]",
        "unit": "RPM", "filter": "taurus.motor.rpm",
    }  # fmt: skip
    # An enum as Foxglove's own schemas have it: a title, a description, and constants with titles.
    mode = schema["properties"]["motor_mode"]
    assert (mode["title"], mode["description"]) == ("Motor mode", "Motor mode")
    assert mode["oneOf"][1] == {"title": "Speed Mode", "const": 1}
    assert (schema["title"], schema["description"]) == ("motor", "Motor Data")
    (flight,) = (row[2] for row in found if row[0] == "/flights")
    assert (flight["messages"], flight["start"]) == (10, "2023-11-14 22:13:20.000000001Z")
    assert [row[2].get("text") for row in found if row[0].startswith("/note")] == [
        "short",
        None,
        "µ longer than the first",
    ]


@pytest.mark.parametrize(("to", "library", "extra"), [("mf4", "asammdf", "mdf"), ("mcap", "mcap", "mcap")])
def test_a_missing_library_is_named_before_any_work(make_capture, yapp_tables, tmp_path, to, library, extra):
    (tmp_path / f"{library}.py").write_text("raise ImportError('not here')")
    done = yapp_tables("convert", make_capture("flight.pcapng", motor=ROWS), "--to", to, "--out", "data")
    assert done.returncode == 2
    assert f"pip install 'yapp-tables[{extra}]'" in done.stderr
    assert not (tmp_path / "data").exists()
