# SPDX-License-Identifier: GPL-2.0-or-later
"""Few large files of many small ones, Delta's old files removed, an older version of the data set converted."""

import json
import os

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
import pytest
import yapp_tables as yt
from deltalake import DeltaTable, write_deltalake
from running import FAKE, result, run_tables
from test_dataset import GROWN, convert, flight
from yapp_tables import upkeep
from yapp_tables.dataset import DataSet

TABLES = ("motor", "events", "faults", "summary", "statistics", "flights")


def rows(folder, name="motor"):
    return ds.dataset(folder / f"data/message={name}").to_table()


def values(folder, name="motor"):
    return in_order(rows(folder, name))


def in_order(table):
    return sorted(table.to_pylist(), key=lambda row: (row["flight_id"], str(row.get("time"))))


@pytest.fixture
def data(make_capture, tmp_path):
    """Ten flights of three messages each, and what is in the tables."""
    for number in range(10):
        flight(make_capture, f"flights/{number}.pcapng", number)
    convert(tmp_path, "flights/*.pcapng")
    return tmp_path, {name: values(tmp_path, name) for name in TABLES}


def compact(folder, *more):
    done = run_tables(folder, "compact", "--out", "data", *more)
    assert done.returncode == 0, done.stderr
    return done.stderr


def files(folder, name="motor"):
    return sorted((folder / f"data/message={name}").glob("*"))


def test_one_file_a_table_has_every_row(data):
    folder, before = data
    assert compact(folder) == f"yapp-tables: {9 * len(TABLES)} files less in data\n"
    for name in TABLES:
        assert len(files(folder, name)) == 1
        assert values(folder, name) == before[name]
    metadata = pq.read_schema(files(folder)[0])
    assert (metadata.metadata[b"schema"], metadata.field("rpm_measured").metadata[b"unit"]) == (b"4", b"RPM")
    assert compact(folder) == "yapp-tables: 0 files less in data\n"
    # It is up to date: no tshark runs but that which tells its version.
    tries = (folder / "flights/1.tries").read_text()
    convert(folder, "flights/*.pcapng")
    assert (folder / "flights/1.tries").read_text() == tries
    assert values(folder) == before["motor"]


def test_the_limits(data):
    folder, before = data
    compact(folder, "--flights", "4")
    assert sorted(pq.read_metadata(path).num_rows for path in files(folder)) == [6, 12, 12]
    assert values(folder) == before["motor"]
    compact(folder, "--megabytes", "1")
    assert len(files(folder)) == 1


def test_a_flight_that_changed_grew_or_went_is_replaced_in_it(data, make_capture):
    folder, _ = data
    compact(folder)
    flight(make_capture, "flights/3.pcapng", 50, 5)
    (folder / "flights/4.pcapng").unlink()
    convert(folder, "flights/*.pcapng")
    assert len(rows(folder)) == 30 - 3 + 5
    assert run_tables(folder, "prune", "--out", "data").returncode == 0
    assert len(rows(folder)) == 30 - 3 + 5 - 3
    assert len(rows(folder, "flights")) == 9
    compact(folder)
    assert len(files(folder)) == 1
    assert len(rows(folder)) == 29


def test_a_catalogue_that_grew_reaches_the_large_files(data, make_capture):
    folder, _ = data
    compact(folder)
    for number in range(1, 10):
        (folder / f"flights/{number}.pcapng").unlink()
    flight(make_capture, "flights/0.pcapng", 0, added="7")
    convert(folder, "flights/0.pcapng", env=os.environ | {"FAKE_COLUMN": json.dumps(GROWN)})
    assert sorted(rows(folder)["added"].to_pylist(), key=str) == [7] * 3 + [None] * 27


@pytest.mark.parametrize("at", ["move", "_finish_merge", "note"])
def test_a_compaction_that_is_killed_is_finished_by_the_next_run(data, monkeypatch, at):
    folder, before = data

    def die(*_arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        original = getattr(DataSet, at)

        def once(self, *arguments):
            if at == "move" and "part-" not in str(arguments[1]):
                return original(self, *arguments)
            return die()

        patch.setattr(DataSet, at, once)
        with pytest.raises(KeyboardInterrupt):
            upkeep.compact(str(folder / "data"), "parquet")
    convert(folder, "flights/*.pcapng")
    for name in TABLES:
        assert values(folder, name) == before[name]
    compact(folder)
    assert values(folder) == before["motor"]


def test_delta_is_compacted_and_vacuumed(make_capture, tmp_path):
    for number in range(3):
        flight(make_capture, f"flights/{number}.pcapng", number)
        convert(tmp_path, f"flights/{number}.pcapng", to="delta")
    flight(make_capture, "flights/0.pcapng", 50)
    convert(tmp_path, "flights/0.pcapng", to="delta")
    compact(tmp_path, "--to", "delta")
    table = DeltaTable(tmp_path / "data/message=motor")
    there = len(list((tmp_path / "data/message=motor").glob("*.parquet")))
    assert there > len(table.file_uris())
    # Nothing is a week old.
    done = run_tables(tmp_path, "vacuum", "--out", "data")
    assert done.stderr == "yapp-tables: 0 files removed from data\n", done.stderr
    assert len(upkeep.need("yapp_tables.delta", "delta").vacuum(f"{tmp_path}/data", "motor", 0)) == there - len(
        table.file_uris()
    )
    assert len(DeltaTable(tmp_path / "data/message=motor").to_pyarrow_table()) == 9


def test_what_cannot_be_compacted_or_vacuumed_is_said(data):
    folder, _ = data
    done = run_tables(folder, "compact", "--out", "data", "--to", "csv")
    assert (done.returncode, "compact is for Parquet" in done.stderr) == (2, True)
    done = run_tables(folder, "vacuum", "--out", "data")
    assert (done.returncode, "has no Delta tables" in done.stderr) == (2, True)


def old_form(table, name):
    """Return a table as version 3 had it: NaN and infinities, seconds, plain strings, fewer columns."""
    for at, field in enumerate(table.schema):
        cells = table[field.name]
        if pa.types.is_dictionary(field.type):
            cells = cells.cast(pa.string())
        if pa.types.is_duration(field.type) or field.name == "timestamp":
            cells = pc.divide(cells.cast(pa.int64()).cast(pa.float64()), 1e9)
        if field.name == "rpm_measured":
            special = table["rpm_measured_special"].to_pylist()
            numbers = [
                {"nan": float("nan"), "inf": float("inf")}.get(word, cell.as_py())
                for word, cell in zip(special, cells, strict=True)
            ]
            cells = pa.chunked_array([pa.array(numbers, pa.float64())])
        old = {"faults": 12, "start": 0, "length": 4670.09}.get(field.name)
        if name == "flights" and old is not None:
            cells = pa.chunked_array([pa.array([old] * len(table)).cast(field.type)])
        table = table.set_column(at, field.with_type(cells.type), cells)
    gone = {"controller", "is_absolute", "clock_resets", "other", "command_lag", "rpm_error"}
    table = table.drop_columns([each for each in table.schema.names if each in gone])
    return table.replace_schema_metadata({b"title": b"Motor Data"})


def make_old(folder, to="parquet"):
    """Give the data set the form of version 3."""
    for path in (folder / "data").rglob("*.parquet") if to == "parquet" else ():
        pq.write_table(old_form(pq.ParquetFile(path).read(), path.parent.name.removeprefix("message=")), path)
    for path in (folder / "data").iterdir() if to == "delta" else ():
        table = old_form(DeltaTable(path).to_pyarrow_table(), path.name.removeprefix("message="))
        write_deltalake(path, table, mode="overwrite", schema_mode="overwrite")
    for note in (folder / f"data.yapp-tables/{to}").glob("*.json"):
        record = json.loads(note.read_text())
        record["made_by"]["layout"] = 3
        note.write_text(json.dumps(record))


def test_delta_of_an_older_version_is_upgraded_without_its_captures(make_capture, tmp_path):
    special = {"rpm_measured": "", "rpm_measured_special": "inf"}
    flight(make_capture, "a.pcapng"), flight(make_capture, "b.pcapng", 30, **special)
    convert(tmp_path, "?.pcapng", to="delta")

    def table(name):
        return DeltaTable(tmp_path / f"data/message={name}").to_pyarrow_table()

    before = {name: table(name) for name in TABLES}
    make_old(tmp_path, "delta")
    assert table("motor").schema.field("timestamp").type == pa.float64()
    assert float("inf") in table("motor")["rpm_measured"].to_pylist()
    (tmp_path / "a.pcapng").unlink()
    for _ in range(2):  # the second time as if the first one had been killed before it noted what it did
        done = run_tables(tmp_path, "upgrade", "--to", "delta", "--out", "data", "--tshark", FAKE)
        assert done.stderr == "yapp-tables: 2 flights upgraded in data\n"
        for name in TABLES:
            after = table(name)
            types = {field.name: field.type for field in before[name].schema}
            assert {field.name: field.type for field in after.schema} == types, name
            names = [each for each in before[name].schema.names if each != "other"]
            assert in_order(after.select(names)) == in_order(before[name].select(names)), name
        for note in (tmp_path / "data.yapp-tables/delta").glob("*.json"):
            text = note.read_text()
            assert '"layout": 4' in text
            note.write_text(text.replace('"layout": 4', '"layout": 3'))
    # A new flight joins the table.
    flight(make_capture, "c.pcapng", 60)
    convert(tmp_path, "c.pcapng", to="delta")
    assert len(table("motor")) == len(before["motor"]) + 3


def test_an_older_version_is_upgraded_without_its_captures(make_capture, tmp_path):
    special = {"rpm_measured": "", "rpm_measured_special": "inf"}
    flight(make_capture, "a.pcapng"), flight(make_capture, "b.pcapng", 30, **special)
    convert(tmp_path, "?.pcapng")
    before = {name: rows(tmp_path, name) for name in TABLES}
    make_old(tmp_path)
    assert rows(tmp_path).schema.field("timestamp").type == pa.float64()
    assert rows(tmp_path).schema.field("bus").type == pa.string()
    assert float("inf") in rows(tmp_path)["rpm_measured"].to_pylist()
    (tmp_path / "a.pcapng").unlink()
    done = run_tables(tmp_path, "upgrade", "--out", "data", "--tshark", FAKE)
    assert done.stderr == "yapp-tables: 2 flights upgraded in data\n"
    for name in TABLES:
        after = rows(tmp_path, name)
        assert {field.name: field.type for field in after.schema} == {f.name: f.type for f in before[name].schema}, name
        # The older version dropped what `other` has.
        names = [each for each in before[name].schema.names if each != "other"]
        assert in_order(after.select(names)) == in_order(before[name].select(names)), name
    assert pq.read_schema(result(tmp_path / "data/message=motor", "a", ".parquet")).metadata[b"schema"] == b"4"
    # It is up to date now.
    tries = (tmp_path / "b.tries").read_text()
    convert(tmp_path, "b.pcapng")
    assert (tmp_path / "b.tries").read_text() == tries
    assert run_tables(tmp_path, "upgrade", "--out", "data", "--tshark", FAKE).stderr.startswith(
        "yapp-tables: 0 flights"
    )


def test_a_kind_that_cannot_be_upgraded_is_said(tmp_path):
    with pytest.raises(yt.SetupError, match="convert the captures again for mf4"):
        upkeep.upgrade(str(tmp_path), "mf4", yt.Tshark())


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
    compact(tmp_path)
    assert len(list((tmp_path / "data/message=motor/day=2023-11-14").iterdir())) == 1
    assert len(rows(tmp_path)) == 9
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
