# SPDX-License-Identifier: GPL-2.0-or-later
"""yapp-tables convert: what is written, what is skipped, what fails and how; with a stand-in for tshark."""

import os
import re
import shlex
import subprocess
import sys

import duckdb
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest
from running import FAKE, motor_row, result
from yapp_tables import cli
from yapp_tables.cli import EXAMPLES

TABLES = ["buses", "events", "faults", "flights", "motor", "points", "steps", "summary"]


def files(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def flight(make_capture, name="flight.pcapng", count=3, **more):
    return make_capture(name, motor=[motor_row(n) for n in range(count)], **more)


def test_parquet_reads_back_with_pandas_polars_and_duckdb(make_capture, yapp_tables, tmp_path):
    yapp_tables("convert", flight(make_capture), "--to", "parquet", "--out", "data", code=0)
    path = result(tmp_path / "data/message=motor", "flight", ".parquet")
    assert files(tmp_path / "data") == [f"message={name}/{path.name}" for name in TABLES]
    assert pq.read_schema(path).field("rpm_measured").metadata[b"unit"] == b"RPM"
    frame = pd.read_parquet(path)
    assert frame["time"].dt.tz is not None
    assert frame["rpm_measured"].tolist() == [1000.5, 1001.5, 1002.5]
    assert pl.read_parquet(path)["time"].dtype == pl.Datetime("ns", "UTC")
    query = f"SELECT message, max(rpm_measured) FROM '{tmp_path}/data/message=motor/*.parquet' GROUP BY message"
    assert duckdb.sql(query).fetchall() == [("motor", 1002.5)]


@pytest.mark.parametrize("to", ["parquet", "delta"])
def test_a_conversion_needs_no_pandas(make_capture, tmp_path, to):
    """Its import takes as long as to write a flight of half an hour."""
    script = "import sys; from yapp_tables.cli import main; print(main(sys.argv[1:]), 'pandas' in sys.modules)"
    command = ["convert", flight(make_capture), "--to", to, "--out", "data", "--tshark", FAKE]
    done = subprocess.run([sys.executable, "-c", script, *command], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "0 False\n", done.stderr


def test_up_to_date_results_are_skipped_and_others_made_again(make_capture, yapp_tables, tmp_path):
    capture = flight(make_capture)
    command = ["convert", capture, "--to", "parquet", "--out", "data"]
    yapp_tables(*command)
    path = result(tmp_path / "data/message=motor", "flight", ".parquet")
    made = path.stat().st_mtime_ns
    os.utime(capture)
    yapp_tables(*command)
    assert path.stat().st_mtime_ns == made
    for change in ("plugin", "options", "file"):
        more, env = [], os.environ
        match change:
            case "plugin":
                env = os.environ | {"FAKE_VERSION": "2.0"}
            case "options":
                more = ["-o", "yapp.motor_ids:0x211"]
            case "file":
                path.unlink()
        yapp_tables(*command, *more, env=env, code=0)
        assert path.stat().st_mtime_ns > made, change
        made = path.stat().st_mtime_ns


def test_failures_are_said_and_hold_nobody_up(make_capture, yapp_tables, tmp_path):
    flight(make_capture, "good.pcap")
    flight(make_capture, "cut.pcap", 4, does=["cut"])
    flight(make_capture, "crash.pcap", 5, does=["crash"])
    make_capture("empty.pcap")
    command = ["convert", "*.pcap", "--to", "parquet", "--out", "data"]
    done = yapp_tables(*command)
    assert done.returncode == 1
    for name, why in (("crash", "signal 11"), ("cut", "read in part: .*cut short"), ("empty", "no YAPP messages")):
        assert re.search(rf"{name}\.pcap: .*{why}", done.stderr)
    assert "3 of 4 captures failed" in done.stderr
    assert [name.partition("-")[0] for name in files(tmp_path / "data/message=motor")] == ["cut", "good"]
    assert list((tmp_path / "data/message=motor").glob("cut-????????.partial.parquet"))
    assert not list((tmp_path / "data.yapp-tables").glob("*-work-*"))
    # A repaired capture replaces what was partial; one that crashed is tried again.
    flight(make_capture, "cut.pcap", 7)
    yapp_tables(*command, code=1)
    result(tmp_path / "data/message=motor", "cut", ".parquet")
    assert not list((tmp_path / "data/message=motor").glob("cut-????????.partial.parquet"))
    assert [name.partition("-")[0] for name in files(tmp_path / "data/message=motor")] == ["crash", "cut", "good"]


# /dev/full takes no byte: a full disk.
def test_a_full_disk_is_a_sentence_and_leaves_no_half_file(make_capture, yapp_tables, tmp_path):
    flight(make_capture)
    (tmp_path / ".page.html.part").symlink_to("/dev/full")
    done = yapp_tables("report", "flight.pcapng", "--out", "page.html")
    assert done.returncode == 2
    assert "page.html cannot be written: No space left on device" in done.stderr
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (["none*.pcap", "--to", "csv", "--out", "data"], 2, "no file matches none*.pcap"),
        (["none.pcap", "--to", "csv", "--out", "data"], 1, "no such file"),
        (["flight.pcap", "--to", "csv", "--out", "flight.pcap"], 2, "cannot be written"),
        (["flight.pcap", "--to", "xls", "--out", "data"], 2, "known kinds: parquet, csv"),
        (["flight.pcap", "--to", "csv", "--out", "data", "--plugin", "none.lua"], 2, "no plugin at"),
        (["flight.pcap", "--to", "csv", "--out", "nosuch://bucket/data"], 2, "nosuch"),
        (["flight.pcap", "--to", "csv", "--out", "s3://bucket"], 2, "names no folder"),
        (["flight.pcap", "--out", "s3:/bucket/data"], 2, "neither a folder nor a URL"),
        (["flight.pcap", "--out", ""], 2, "'' is neither a folder nor a URL"),
        (["flight.pcap", "--out", "data", "--jobs", "0"], 2, "--jobs 0: at least 1 capture at a time"),
    ],
)
def test_bad_input_gets_a_sentence(make_capture, yapp_tables, arguments, code, sentence):
    flight(make_capture, "flight.pcap")
    done = yapp_tables("convert", *arguments)
    assert done.returncode == code
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("option", "name", "sentence"),
    [
        ("--rules", "none.rules", "none.rules: No such file or directory"),
        ("--rules", "bad.rules", "1 error in the file of rules:\n  line 2: motor.rpm=1: no field"),
        ("--out", ".", "'.' is a folder"),
        ("--out", "none/page.html", "in no folder"),
    ],
)
def test_a_report_that_cannot_be_written(make_capture, yapp_tables, tmp_path, option, name, sentence):
    flight(make_capture, says="yapp: check: rules:2: motor.rpm=1: no field")
    (tmp_path / "bad.rules").write_text("fault=0\nmotor.rpm=1\n")
    done = yapp_tables("report", "flight.pcapng", option, name)
    assert (done.returncode, sentence in done.stderr) == (2, True), done.stderr
    assert not list(tmp_path.glob("*.html"))


@pytest.mark.parametrize("command", EXAMPLES)
def test_help_has_two_examples_that_can_be_parsed(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    said = capsys.readouterr().out
    assert said.count(f"\n  yapp-tables {command}") == 2
    for example in EXAMPLES[command]:
        words = shlex.split(example.partition("&&")[0].partition("||")[0])
        assert cli._parser().parse_args([command, *words]).run
