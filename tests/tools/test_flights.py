# SPDX-License-Identifier: GPL-2.0-or-later
"""Real tshark, the real plugin, flights with known truth: every value, every event, in every kind of file."""

import json
import math
import subprocess
from collections import Counter

import flights
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yapp_tables as yt
from running import PLUGIN, run_tables

OPTIONS = [word for option in flights.OPTIONS for word in ("-o", option)]


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Where a flight is, and its truth."""
    path = tmp_path_factory.mktemp("flight") / "flight.pcapng"
    return path, flights.write(path, 3, 60)


def convert(path, to):
    run_tables(path.parent, "convert", path, "--to", to, "--out", to, *OPTIONS, "--plugin", PLUGIN, code=0)
    return path.parent / to


def speeds(truth):
    """Time, bus, id and speed of every Motor Data message, in order of time; None for a reserved count."""
    rows = sorted(truth.motor)
    return [
        (time, bus, number, None if raw == flights.NAN16 else flights.value(raw, -60000, 60000, 65530))
        for time, bus, number, raw, _, _ in rows
    ]


def assert_speeds(found, truth):
    """found: (time, bus, id, speed) in any order, NaN or None for a reserved count."""
    found, expected = sorted(found, key=lambda row: row[0]), speeds(truth)
    assert [row[:3] for row in found] == [row[:3] for row in expected]
    for row, (_, _, _, speed) in zip(found, expected, strict=True):
        assert (row[3] is None or math.isnan(row[3])) if speed is None else abs(row[3] - speed) < 0.01


def test_types_and_what_the_metadata_says(flight):
    motor = yt.read(flight[0], options=flights.OPTIONS, plugin=PLUGIN)["motor"].schema
    assert motor.names[:8] == ["time", "source_file", "bus", "frame", "source", "controller", "id", "seq"]
    assert motor.field("time").type == pa.timestamp("ns", tz="UTC")
    assert [motor.metadata[key] for key in (b"title", b"every", b"schema")] == [b"Motor Data", b"0.1", b"6"]
    kind = pa.dictionary(pa.int32(), pa.string())
    types = {"rpm_measured": pa.float64(), "motor_mode": pa.uint8(), "motor_mode_text": kind, "bus": kind}
    types |= {"fault_flags": pa.uint32(), "fault_motor_stall": pa.bool_(), "esc_temperature_special": kind}
    types |= {"timestamp": pa.duration("ns"), "rpm_error": pa.float64()}
    assert {name: motor.field(name).type for name in types} == types
    assert motor.field("rpm_measured").metadata[b"unit"] == b"RPM"
    assert json.loads(motor.field("motor_mode").metadata[b"values"]) == {"0": "Torque Mode", "1": "Speed Mode"}
    assert motor.field("fault_motor_stall").metadata[b"filter"] == b"taurus.motor.fault.motor_stall"


def test_read_has_every_value_and_every_event(flight):
    path, truth = flight
    read = yt.read(path, options=flights.OPTIONS, plugin=PLUGIN)
    assert (len(read["health"]), len(read["command"])) == (truth.health, truth.command)
    motor = read["motor"]
    columns = (motor[name].to_pylist() for name in ("bus", "id", "rpm_measured"))
    found = list(zip(motor["time"].cast("int64").to_pylist(), *columns, strict=True))
    assert_speeds(found, truth)
    with pytest.raises(AssertionError):
        assert_speeds([*found[1:], (*found[0][:3], 77.7)], truth)
    hot = [row[4] for row in sorted(truth.motor)]
    specials = motor.sort_by("time")["esc_temperature_special"].to_pylist()
    assert specials == [{flights.NAN8: "nan", flights.ABOVE8: "above"}.get(raw) for raw in hot]
    # The state Faulted, where it counts, follows from the flags.
    events = [row for row in read.events.to_pylist() if row["flag"] != "faulted"]
    faults = {(row["time"].value, row["bus"], row["id"], row["flag"]) for row in events if row["event"] == "raised"}
    assert faults == {(begin, bus, number, flag) for begin, _, bus, number, flag in truth.faults}
    assert sum(row["event"] == "cleared" for row in events) == sum(end is not None for _, end, *_ in truth.faults)
    reboots = [(row["time"].value, row["bus"], row["id"]) for row in events if row["kind"] == "reboot"]
    assert [row for row in reboots if row[2] >= 0x210] == truth.reboots
    assert sum(row["kind"] == "incomplete" for row in events) == len(truth.incomplete)
    counts = {(row["bus"], row["id"]): row["count"] for row in read.summary.to_pylist()}
    for bus, number in {row[1:3] for row in truth.motor}:
        assert counts[bus, number] == sum(row[1:3] == (bus, number) for row in truth.motor)


def test_a_filter_narrows(flight):
    path, truth = flight
    fault = yt.read(path, options=flights.OPTIONS, plugin=PLUGIN, filter="taurus.motor.fault.motor_overcurrent == 1")
    assert list(fault) == ["motor"]
    assert len(fault["motor"]) == sum(row[5] == flights.OVERCURRENT for row in truth.motor)


def test_a_cut_capture_is_partial(flight, tmp_path):
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(flight[0].read_bytes()[:-50_005])
    done = run_tables(tmp_path, "convert", cut, "--to", "parquet", "--out", "data", *OPTIONS, "--plugin", PLUGIN)
    assert done.returncode == 1
    assert "cut short" in done.stderr
    assert list((tmp_path / "data/message=motor").glob("cut-????????.partial.parquet"))


def test_what_the_plugin_complains_of_is_passed_on(flight, tmp_path, monkeypatch):
    (tmp_path / "bad.lua").write_text('return {{name="m",title="M",id=5,size=3,{"x","uint8","X"}}}')
    monkeypatch.setenv("YAPP_MESSAGES", str(tmp_path / "bad.lua"))
    options = [*OPTIONS, "-o", "yapp.late:abc", "--plugin", PLUGIN]
    for arguments in (
        ["convert", flight[0], "--to", "csv", "--out", "data"],
        ["report", flight[0], "--out", "page.html"],
    ):
        done = run_tables(tmp_path, *arguments, *options)
        assert done.returncode == 3
        for text in (
            "bad.lua: message m: size is 3, but the fields add up to 1 byte",
            'yapp.late: no number above 0 in "abc"',
        ):
            assert done.stderr.count(text) == 1
    with pytest.warns(UserWarning, match="the fields add up to 1 byte"):
        yt.read(flight[0], options=flights.OPTIONS, plugin=PLUGIN)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-o", "yapp.no_such:1"], "yapp.no_such"),
        (["--filter", "no such filter"], "no such filter"),
        (["--bitrate", "0"], "bitrate=0"),
    ],
)
def test_what_tshark_refuses_is_said_in_one_sentence(flight, tmp_path, arguments, sentence):
    done = run_tables(tmp_path, "convert", flight[0], "--to", "csv", "--out", "data", "--plugin", PLUGIN, *arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_buses_in_tables_and_on_the_page(flight, tmp_path):
    command = ["tshark", "-r", flight[0], "-T", "fields", "-e", "frame.interface_name", "-Y", "can"]
    names = Counter(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    how = ["--bitrate", "500000", *OPTIONS, "--plugin", PLUGIN]
    run_tables(tmp_path, "convert", flight[0], "--to", "parquet", "--out", "data", *how, code=0)
    rows = pq.read_table(tmp_path / "data/message=buses").to_pylist()
    assert {row["bus"]: row["frames"] for row in rows} == {row["bus"]: row["yapp"] for row in rows} == names
    for row in rows:
        bits = 131 * row["rate"]  # of 8 bytes with an extended ID, besides stuffing
        assert 0.8 * bits < 500_000 * row["load"] < 1.1 * bits
        assert 0.2 > row["load_max"] >= row["load"]
    run_tables(tmp_path, "report", flight[0], "--out", "page.html", *how, code=0)
    assert f"{names['can0']:,} frames, {names['can0']:,} of YAPP, load " in (tmp_path / "page.html").read_text()
