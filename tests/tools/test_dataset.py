# SPDX-License-Identifier: GPL-2.0-or-later
"""A data set over years: moved, deleted and changed captures, catalogues that grow, clouds, Delta tables, fleets."""

import json
import os
import shlex
import shutil
import signal
from concurrent.futures import ThreadPoolExecutor

import duckdb
import pandas as pd
import polars as pl
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
import yapp_tables as yt
from deltalake import DeltaTable
from distributed import Client, LocalCluster
from running import FAKE, killing, motor_row, run_tables, wait_for_results
from yapp_tables.dataset import DataSet, Result

FAULT = {"time": 1700000000.000000001, "frame": 3, "bus": "can0", "source": None, "id": 528, "message": "motor"}
FAULT |= {"kind": "fault", "field": "fault_flags", "flag": "motor_overcurrent", "event": "raised", "active": None}
SUMMARY = {"bus": "can0", "id": 528, "source": None, "message": "motor", "count": 3}
SUMMARY |= {"new_key": [1]}
# A catalogue that grew: another field of Motor Data.
GROWN = {"name": "added", "type": "integer", "kind": "uint", "bits": 16}


def flight(make_capture, name="flight.pcapng", first=0, count=3, **more):
    rows = [motor_row(first + n, **more) for n in range(count)]
    return make_capture(name, motor=rows, events=[FAULT], summary=[SUMMARY])


def convert(folder, *captures, to="parquet", out="data", code=0, env=None, more=()):
    command = ["convert", *captures, "--to", to, "--out", out, "--tshark", FAKE, *more]
    return run_tables(folder, *command, env=env or os.environ, code=code).stderr


def motor(folder):
    return ds.dataset(folder / "data/message=motor").to_table()


def test_every_reader_opens_the_folder(make_capture, tmp_path):
    flight(make_capture), flight(make_capture, "other.pcapng", 9), make_capture("empty.pcapng")
    convert(tmp_path, "*.pcapng", code=1)
    data = tmp_path / "data"
    assert len(pd.read_parquet(data)) == ds.dataset(data, partitioning="hive").count_rows() == 14
    tables = (pl.scan_parquet(folder / "*.parquet", hive_partitioning=True) for folder in data.iterdir())
    every = pl.concat(tables, how="diagonal_relaxed").collect()
    assert len(every) == 14
    names = [set(pq.read_schema(next(folder.glob("*"))).names) for folder in data.iterdir()]
    assert set(every.columns) == set.union(*names, {"message"})
    query = f"SELECT message, count(*) FROM read_parquet('{data}/**/*.parquet', union_by_name=true) GROUP BY 1"
    counts = {"motor": 6, "events": 2, "faults": 2, "summary": 2, "flights": 2}
    assert dict(duckdb.sql(query).fetchall()) == counts
    for name, count in counts.items():
        table = pl.read_parquet(data / f"message={name}")
        assert len(table) == count
        assert table["flight_id"].n_unique() == 2


def test_the_flights(make_capture, tmp_path):
    capture = flight(make_capture)
    convert(tmp_path, "flight.pcapng")
    (row,) = pl.read_parquet(tmp_path / "data/message=flights").to_dicts()
    assert row["capture"] == str(capture)
    assert (row["messages"], row["faults"], row["plugin"]) == (3, 1, "1.0")
    assert row["left_out"] is None
    assert row["length"] == pytest.approx(0.2)
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
    # Deleted captures stay.
    (tmp_path / "a/flight.pcapng").unlink()
    convert(tmp_path, "*/*.pcapng")
    assert len(motor(tmp_path)) == 11


@pytest.mark.parametrize("to", ["parquet", "csv", "delta"])
def test_a_catalogue_that_grew(make_capture, tmp_path, to):
    """Captures are converted again; where one is gone, readers fill the new column."""
    old, new = flight(make_capture, "old.pcapng"), flight(make_capture, "new.pcapng", 20, added="7")
    convert(tmp_path, "old.pcapng", to=to)
    old.unlink()
    convert(tmp_path, new, to=to, env=os.environ | {"FAKE_COLUMN": json.dumps(GROWN)})
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
    notes = tmp_path / "data.yapp-tables"
    (notes / f"{to}-6").rename(notes / f"{to}-5")
    said = convert(tmp_path, "flights/a.pcapng", to=to, code=2)
    assert said.startswith(f"yapp-tables: {tmp_path}/data has not version 6 of the tables; make it anew: ")
    command = shlex.split(said.partition("make it anew: ")[2].replace("CAPTURES", "flights/a.pcapng"))
    run_tables(tmp_path, *command[1:], "--tshark", FAKE, code=0)
    assert (tmp_path / "data-6/message=motor").is_dir()


def test_many_open_a_new_data_set_at_once(tmp_path):
    def use(number):
        dataset = DataSet(str(tmp_path / f"data{number // 8}"), "csv")
        dataset.open()
        dataset.note(Result(f"{number:016}", "flight.pcapng", "plugin 3"))
        assert len(list(dataset.results())) <= 8

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(use, range(400)))
    for data in range(50):
        assert len(list(DataSet(str(tmp_path / f"data{data}"), "csv").results())) == 8


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


def test_convert_one_is_what_a_scheduler_calls(make_capture, tmp_path):
    capture = flight(make_capture)
    how = {"out": str(tmp_path / "data"), "tshark": str(FAKE)}
    cluster = LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:
        results = client.gather(client.map(yt.convert_one, [str(capture)] * 3, pure=False, **how))
    assert len({one.flight_id for one in results}) == 1
    assert results[0].messages["motor"] == 3
    assert len(motor(tmp_path)) == 3
    missing = yt.convert_one(tmp_path / "none.pcapng", **how)
    assert (missing.failure, missing.flight_id) == ("no such file", "")
