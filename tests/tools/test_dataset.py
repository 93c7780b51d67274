# SPDX-License-Identifier: GPL-2.0-or-later
"""A data set over years: moved, deleted and changed captures, catalogues that grow, clouds, Delta tables, fleets."""

import json
import os
import shlex
import shutil
import signal
import subprocess

import duckdb
import pandas as pd
import polars as pl
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
import yapp_tables as yt
from deltalake import DeltaTable
from distributed import Client, LocalCluster
from running import FAKE, killing, motor_row, result, run_tables, wait_for_results

FAULT = {"time": 1700000000.000000001, "frame": 3, "bus": "can0", "source": None, "id": 528, "message": "motor"}
FAULT |= {"kind": "fault", "field": "fault_flags", "flag": "motor_overcurrent", "event": "raised", "active": None}
SUMMARY = {"bus": "can0", "id": 528, "source": None, "message": "motor", "count": 3}
SUMMARY |= {"values": {"rpm_measured": {"min": 1000.5, "mean": 1001.5, "max": 1002.5}}, "new_key": [1]}
# A catalogue that grew: another field of Motor Data.
GROWN = {"name": "added", "type": "integer", "kind": "uint", "bits": 16}


def flight(make_capture, name="flight.pcapng", first=0, count=3, **more):
    rows = [motor_row(first + n, **more) for n in range(count)]
    return make_capture(name, motor=rows, events=[FAULT], summary=[SUMMARY])


def convert(folder, *captures, to="parquet", out="data", code=0, env=None, more=()):
    command = ["convert", *captures, "--to", to, "--out", out, "--tshark", FAKE, *more]
    done = run_tables(folder, *command, env=env or os.environ)
    assert done.returncode == code, done.stderr
    return done.stderr


def motor(folder):
    return ds.dataset(folder / "data/message=motor").to_table()


def test_every_reader_opens_the_folder(make_capture, tmp_path):
    flight(make_capture), flight(make_capture, "other.pcapng", 9), make_capture("empty.pcapng")
    convert(tmp_path, "*.pcapng", code=1)
    data = tmp_path / "data"
    assert len(pd.read_parquet(data)) == ds.dataset(data, partitioning="hive").count_rows() == 16
    tables = (pl.scan_parquet(folder / "*.parquet", hive_partitioning=True) for folder in data.iterdir())
    every = pl.concat(tables, how="diagonal_relaxed").collect()
    assert len(every) == 16
    names = [set(pq.read_schema(next(folder.glob("*"))).names) for folder in data.iterdir()]
    assert set(every.columns) == set.union(*names, {"message"})
    query = f"SELECT message, count(*) FROM read_parquet('{data}/**/*.parquet', union_by_name=true) GROUP BY 1"
    counts = {"motor": 6, "events": 2, "faults": 2, "summary": 2, "statistics": 2, "flights": 2}
    assert dict(duckdb.sql(query).fetchall()) == counts
    for name, count in counts.items():
        table = pl.read_parquet(data / f"message={name}")
        assert len(table) == count
        assert table["flight_id"].n_unique() == 2


@pytest.mark.parametrize("to", ["csv", "mf4", "mcap", "delta"])
def test_every_format_has_the_tables(make_capture, tmp_path, to):
    flight(make_capture)
    convert(tmp_path, "flight.pcapng", to=to)
    names = {"motor", "events", "faults", "summary", "statistics", "steps", "points", "flights"}
    if to in ("csv", "delta"):
        assert {path.name for path in (tmp_path / "data").iterdir()} == {f"message={name}" for name in names}
    else:
        content = result(tmp_path / "data", "flight", f".{to}").read_bytes()
        empty = {"steps", "points"} if to == "mf4" else set()  # a group without rows is none
        assert [name for name in names - empty if name.encode() not in content] == []


def test_the_flights(make_capture, tmp_path):
    capture = flight(make_capture)
    convert(tmp_path, "flight.pcapng")
    (row,) = pl.read_parquet(tmp_path / "data/message=flights").to_dicts()
    assert row["capture"] == str(capture)
    assert (row["messages"], row["faults"], row["plugin"]) == (3, 1, "1.0")
    assert (row["is_absolute"], row["clock_resets"], row["left_out"]) == (True, 0, None)
    assert row["length"] == pytest.approx(0.2)
    assert row["undecoded"] is None
    assert len(row["flight_id"]) == 16
    (event,) = pl.read_parquet(tmp_path / "data/message=events").to_dicts()
    assert (event["message_name"], event["flag"], event["flight_id"]) == (
        "motor",
        "motor_overcurrent",
        row["flight_id"],
    )


def test_moved_copied_and_changed_captures_are_in_it_once(make_capture, tmp_path):
    flight(make_capture, "a/flight.pcapng"), flight(make_capture, "b/flight.pcapng", 20)
    convert(tmp_path, "*/*.pcapng")
    before = motor(tmp_path)
    assert set(before["source_file"].to_pylist()) == {"flight.pcapng"}
    (tmp_path / "c").mkdir()
    shutil.move(tmp_path / "a/flight.pcapng", tmp_path / "c/renamed.pcapng")
    shutil.copy(tmp_path / "b/flight.pcapng", tmp_path / "c/copy.pcapng")
    convert(tmp_path, "c/*.pcapng", "b/*.pcapng")
    assert motor(tmp_path).equals(before)
    # Another flight at a path whose former flight was moved.
    flight(make_capture, "a/flight.pcapng", 40)
    convert(tmp_path, "*/*.pcapng")
    assert len(motor(tmp_path)) == 9
    # A capture that grew.
    flight(make_capture, "a/flight.pcapng", 40, 5)
    convert(tmp_path, "a/flight.pcapng")
    assert len(motor(tmp_path)) == 11
    # Deleted captures stay until they are pruned.
    (tmp_path / "a/flight.pcapng").unlink()
    convert(tmp_path, "*/*.pcapng")
    assert len(motor(tmp_path)) == 11
    done = run_tables(tmp_path, "prune", "--out", "data")
    assert done.stdout == f"removed   {tmp_path}/a/flight.pcapng\n"
    assert len(motor(tmp_path)) == 6
    assert len(pl.read_parquet(tmp_path / "data/message=flights")) == 2


def test_prune_of_an_unmounted_disk_removes_nothing(make_capture, tmp_path):
    flight(make_capture).rename(convert(tmp_path, "flight.pcapng") and tmp_path / "elsewhere")
    done = run_tables(tmp_path, "prune", "--out", "data")
    assert done.returncode == 2
    assert "is their disk mounted?" in done.stderr
    assert len(motor(tmp_path)) == 3


@pytest.mark.parametrize("to", ["parquet", "csv", "delta"])
def test_a_catalogue_that_grew(make_capture, tmp_path, to):
    """What it changed is converted again; where the capture is gone, readers fill the new column."""
    old, new = flight(make_capture, "old.pcapng"), flight(make_capture, "new.pcapng", 20, added="7")
    note = make_capture("note.pcapng", note=[motor_row(0, text="x")])
    convert(tmp_path, "old.pcapng", "note.pcapng", to=to)
    old.unlink()
    paths = list((tmp_path / "data/message=note").glob(f"*.{to}"))
    times = [path.stat().st_mtime_ns for path in paths]
    convert(tmp_path, new, note, to=to, env=os.environ | {"FAKE_COLUMN": json.dumps(GROWN)})
    assert [path.stat().st_mtime_ns for path in paths] == times
    if to == "delta":
        found = DeltaTable(tmp_path / "data/message=motor").to_pyarrow_table()["added"].to_pylist()
    else:
        files = f"read_{to}('{tmp_path}/data/message=motor/*.{to}', union_by_name=true)"
        found = [value for (value,) in duckdb.sql(f"SELECT added FROM {files}").fetchall()]
    assert sorted(found, key=str) == [7, 7, 7, None, None, None]


@pytest.mark.parametrize("to", ["parquet", "delta"])
def test_an_older_version_is_refused_with_the_command_that_makes_it_anew(make_capture, tmp_path, to):
    flight(make_capture, "flights/a.pcapng")
    convert(tmp_path, "flights/a.pcapng", to=to)
    (tmp_path / f"data.yapp-tables/{to}/paths/schema.json").unlink()  # as version 4 left it
    said = convert(tmp_path, "flights/a.pcapng", to=to, code=2)
    assert said.startswith(f"yapp-tables: {tmp_path}/data has version 4 or older of the tables, not 5; make it anew: ")
    command = shlex.split(said.partition("make it anew: ")[2])
    assert run_tables(tmp_path, *command[1:], "--tshark", FAKE).returncode == 0
    assert (tmp_path / "data-5/message=motor").is_dir()


def test_partitions_by_day_and_by_vehicle(make_capture, tmp_path):
    old = {"time": "12.000000000"}
    flight(make_capture, "a.pcapng"), flight(make_capture, "b.pcapng", 5), flight(make_capture, "dump.pcapng", **old)
    convert(tmp_path, "?.pcapng", "dump.pcapng", more=["--partition", "day"])
    folders = sorted(path.name for path in (tmp_path / "data/message=motor").iterdir())
    assert folders == ["day=2023-11-14", "day=__HIVE_DEFAULT_PARTITION__"]
    table = ds.dataset(tmp_path / "data/message=motor", partitioning="hive").to_table(
        filter=ds.field("day") == "2023-11-14"
    )
    assert len(table) == 6
    (tmp_path / "fleet.toml").write_text('[[aircraft]]\nname = "N 1/a"\ncaptures = "a.pcapng"\n')
    more = ["--partition", "vehicle", "--fleet", "fleet.toml"]
    convert(tmp_path, "?.pcapng", out="other", more=more)
    found = ds.dataset(tmp_path / "other/message=motor", partitioning="hive").to_table()
    vehicles = dict(zip(found["source_file"].to_pylist(), found["vehicle"].to_pylist(), strict=True))
    assert vehicles == {"a.pcapng": "N 1/a", "b.pcapng": None}
    # Its own types of columns cannot have a folder without a name.
    frame = pd.read_parquet(tmp_path / "other/message=motor", dtype_backend="pyarrow")
    assert frame.groupby("vehicle", dropna=False).size().tolist() == [3, 3]
    assert "mcap has no partitions" in convert(tmp_path, "a.pcapng", to="mcap", out="third", code=2, more=more)


def test_a_url_with_a_slip_is_no_folder(make_capture, tmp_path):
    assert "s3:/bucket is neither a folder nor a URL" in convert(
        tmp_path, flight(make_capture), out="s3:/bucket", code=2
    )
    assert not (tmp_path / "s3:").exists()


def test_a_cloud(make_capture, tmp_path, monkeypatch):
    moto = pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer(port=0)
    server.start()
    try:
        host, port = server.get_host_and_port()
        for name, text in {
            "AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "x", "AWS_SECRET_ACCESS_KEY": "x",
            "AWS_REGION": "us-east-1", "AWS_ALLOW_HTTP": "true", "AWS_DEFAULT_REGION": "us-east-1",
        }.items():  # fmt: skip
            monkeypatch.setenv(name, text)
        import s3fs

        s3 = s3fs.S3FileSystem(anon=False)
        s3.mkdir("bucket")
        flight(make_capture), flight(make_capture, "other.pcapng", 9)
        for _ in range(2):
            convert(tmp_path, "*.pcapng", out="s3://bucket/data")
            assert not (tmp_path / "s3:").exists()
            table = ds.dataset("bucket/data/message=motor", filesystem=s3).to_table()
            assert len(table) == 6
        convert(tmp_path, "*.pcapng", out="s3://bucket/lake", to="delta")
        assert len(DeltaTable("s3://bucket/lake/message=motor").to_pyarrow_table()) == 6
        assert len(s3.ls("bucket/data.yapp-tables")) == 2
    finally:
        server.stop()


def test_delta_tables_of_several_workers_one_of_which_is_killed(make_capture, tmp_path):
    count = 12
    for number in range(count):
        rows = [motor_row(n, rpm_measured=str(number)) for n in range(50 + number)]
        make_capture(f"flights/{number:02}.pcapng", motor=rows, does=["nap"], events=[FAULT])
    with LocalCluster(n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        pids = [worker.process.pid for worker in cluster.workers.values()]

        def kill():
            wait_for_results(tmp_path, 3)
            os.kill(pids[0], signal.SIGKILL)

        with killing(tmp_path, kill):
            convert(tmp_path, "flights/*.pcapng", to="delta", more=["--scheduler", cluster.scheduler_address])
    for _ in range(2):
        table = DeltaTable(tmp_path / "data/message=motor").to_pyarrow_table()
        rows = (
            table.group_by("source_file").aggregate([("time_ns", "count_distinct"), ("time_ns", "count")]).to_pylist()
        )
        found = {row["source_file"]: (row["time_ns_count_distinct"], row["time_ns_count"]) for row in rows}
        assert found == {f"{number:02}.pcapng": (50 + number, 50 + number) for number in range(count)}
        convert(tmp_path, "flights/*.pcapng", to="delta")
    assert len(DeltaTable(tmp_path / "data/message=motor").file_uris()) < count  # compacted


FLEET = """
[[aircraft]]
name = "N101"
captures = "flights/n101/**"
ids = { motor = "0x210-0x213", note = "0x300" }
sources = { "can0/0x210" = "motor:left" }

[[aircraft]]
name = "N102"
captures = "flights/n102/*.pcapng"
profile = "Other"
catalogue = "n102.lua"
preferences = { "yapp.late" = "3" }
"""


def test_a_fleet_file(make_capture, tmp_path):
    (tmp_path / "fleet.toml").write_text(FLEET)
    captures = [flight(make_capture, f"flights/{name}.pcapng", n) for n, name in enumerate(("n101/x/a", "n102/b", "c"))]
    convert(tmp_path, *captures, more=["--fleet", "fleet.toml", "-o", "yapp.x:1"])
    table = pl.read_parquet(tmp_path / "data/message=flights").sort("capture")
    assert table["aircraft"].to_list() == [None, "N101", "N102"]
    asked = [json.loads(path.with_suffix(".asked").read_text().splitlines()[-1]) for path in captures]
    assert asked[0]["o"] == [
        "yapp.motor_ids:0x210-0x213",
        "yapp.note_ids:0x300",
        "yapp.sources:can0/0x210=motor:left",
        "yapp.x:1",
    ]
    assert (asked[1]["o"], asked[1]["C"]) == (["yapp.late:3", "yapp.x:1"], "Other")
    assert asked[1]["messages"] == str(tmp_path / "n102.lua")
    assert (asked[2]["o"], asked[2]["C"], asked[2]["messages"]) == (["yapp.x:1"], None, None)
    (tmp_path / "fleet.toml").write_text(FLEET.replace("profile", "profil"))
    assert "no key profil; known keys" in convert(tmp_path, *captures, code=2, more=["--fleet", "fleet.toml"])


def test_convert_one_is_what_a_scheduler_calls(make_capture, tmp_path):
    capture = flight(make_capture)
    config = yt.Config(str(tmp_path / "data"), "parquet", yt.Tshark(program=str(FAKE)))
    cluster = LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:
        results = client.gather(client.map(yt.convert_one, [str(capture)] * 3, config=config, pure=False))
    assert len({one.flight_id for one in results}) == 1
    assert results[0].messages["motor"] == 3
    assert len(motor(tmp_path)) == 3
    missing = yt.convert_one(tmp_path / "none.pcapng", config)
    assert (missing.failure, missing.flight_id) == ("no such file", "")


def test_python_converts_reads_many_and_keeps_what_tshark_wrote(make_capture, tmp_path):
    flight(make_capture, "a.pcapng"), flight(make_capture, "b.pcapng", 9)
    make_capture("c.pcapng")
    how = {"tshark": FAKE}
    results = yt.convert(f"{tmp_path}/?.pcapng", tmp_path / "out", to="csv", **how)
    assert [bool(one.failure) for one in results] == [False, False, True]
    tries = []
    for _ in range(2):
        with pytest.warns(UserWarning, match=r"c\.pcapng: no YAPP messages"):
            found = list(
                yt.read_many(f"{tmp_path}/?.pcapng", cache=tmp_path / "cache", columns=["rpm_measured"], **how)
            )
        assert [one.name for one in found] == ["a.pcapng", "b.pcapng"]
        assert found[0]["motor"].schema.names == ["time", "rpm_measured"]
        tries.append(len((tmp_path / "a.tries").read_text()))
    assert tries[0] == tries[1]


def test_nothing_silences_logging(make_capture, tmp_path):
    flight(make_capture, "a.pcapng")
    code = (
        "import logging, yapp_tables as yt\n"
        f"yt.convert('a.pcapng', 'out', tshark={str(FAKE)!r})\n"
        "logging.getLogger('distributed').warning('heard')"
    )
    done = subprocess.run([os.sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "heard" in done.stderr


def test_names_of_controllers_and_a_plot(make_capture):
    capture = flight(make_capture)
    read = yt.read(capture, tshark=FAKE, sources={"can0/0x210": "motor:left"}, messages=["motor"])
    asked = json.loads(capture.with_suffix(".asked").read_text().splitlines()[0])
    assert asked["o"] == ["yapp.sources:can0/0x210=motor:left"]
    figure = read.plot("motor.rpm_measured")
    assert [trace.name for trace in figure.data] == ["can0 0x210 Measured speed"]
    assert list(figure.data[0].y) == [1000.5, 1001.5, 1002.5]
    assert figure.layout.yaxis.title.text == "RPM"
    with pytest.raises(yt.MessageError, match="no field 'rpm' in motor; it has"):
        read.plot("motor.rpm")
    assert "<td>Motor Data</td>" in read._repr_html_()
    assert yt.__version__
