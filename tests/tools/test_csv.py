# SPDX-License-Identifier: GPL-2.0-or-later
"""Tables of -z yapp,csv in pandas and polars, read with the types of fields.json: every value the truth's."""

import importlib.util
import json
import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import pandas as pd
import pytest
from running import PLUGIN

TESTS = Path(__file__).parents[1]
sys.path.append(str(TESTS / "e2e"))
import model  # noqa: E402

# With the types of fields.json.
RECIPE = """\
import json, pandas, polars

columns = json.load(open("tables/fields.json"))["messages"]["motor"]["columns"]
for column in columns:
    if column["bits"] == 64 and column["kind"] != "int":
        column["type"] = "unsigned"  # it does not fit in an Int64

types = {"time": "string", "float": "float64", "integer": "Int64", "unsigned": "UInt64",
         "bool": "boolean", "string": "string"}
motor = pandas.read_csv("tables/motor.csv", keep_default_na=False, na_values=[""],
                        dtype={column["name"]: types[column["type"]] for column in columns})
motor.index = pandas.to_datetime(motor["time"].str.replace(".", "").astype("int64"), utc=True)

types = {"time": polars.Decimal(38, 9), "float": polars.Float64, "integer": polars.Int64, "unsigned": polars.UInt64,
         "bool": polars.Int8, "string": polars.String}
motor = polars.read_csv("tables/motor.csv",
                        schema_overrides={column["name"]: types[column["type"]] for column in columns})
"""
SPECIALS = ["nan", "inf", "-inf", "above", "below"]


def generator():
    """The flights of the end-to-end tests: another module of this name."""
    spec = importlib.util.spec_from_file_location("e2e_flights", TESTS / "e2e/flights.py")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", params=[3, 5])
def flight(request, tmp_path_factory):
    """A folder with the tables of a flight, and the flight."""
    folder = tmp_path_factory.mktemp("csv")
    made = generator().make(request.param)
    made.write(folder / "flight.pcapng", "pcapng")
    command = ["tshark", "-X", f"lua_script:{PLUGIN}", *made.arguments("pcapng"), "-q", "-r", "flight.pcapng"]
    subprocess.run([*command, "-z", "yapp,csv,tables"], cwd=folder, check=True)
    return folder, made


def cells_of(frame, bus, source, message):
    """What a row has to have: {column: value}."""
    yield from {
        "time": Decimal(frame.at).scaleb(-9), "frame": frame.number, "bus": bus, "source": source,
        "id": message.sender.ident, "seq": message.seq,
    }.items()  # fmt: skip
    at = 0
    for field, size, kind in model.MESSAGES[message.sender.ident & ~0xF][2]:
        count = int.from_bytes(message.payload[at : at + size], "little")
        at += size
        if kind is None:
            yield field, Decimal(count).scaleb(-9)
        elif model.is_float(kind):
            special = 2 ** (8 * size) - 1 - count
            value = pytest.approx(model.value(count, size, kind[0], kind[1]), rel=1e-6, abs=1e-9)
            yield field, None if special < 5 else value
            yield f"{field}_special", SPECIALS[special] if special < 5 else None
        else:
            yield field, count
            for bit, flag in (kind[1] if model.is_flags(kind) else {}).items():
                yield f"{kind[0]}_{flag}", bool(count & bit)


def read(folder, monkeypatch):
    """The message motor as the recipe reads it: with pandas, and with polars."""
    monkeypatch.chdir(folder)
    first, second = {}, {}
    exec(RECIPE.rsplit("\ntypes", 1)[0], first)
    exec(RECIPE, second)
    return first["motor"], second["motor"]


def test_every_value(flight, monkeypatch):
    folder, made = flight
    by_pandas, by_polars = read(folder, monkeypatch)
    rows = made.rows("pcapng")["motor"]
    assert len(by_pandas) == len(by_polars) == len(rows) > 30
    for one, other, truth in zip(by_pandas.to_dict("records"), by_polars.to_dicts(), rows, strict=True):
        for name, value in cells_of(*truth):
            shown = None if pd.isna(one[name]) else one[name]
            assert (Decimal(shown) if isinstance(value, Decimal) else shown) == value, name
            assert other[name] == value, name
    assert [stamp.value for stamp in by_pandas.index] == [frame.at for frame, *_ in rows]


def test_an_unsigned_integer_of_64_bits(tmp_path, monkeypatch):
    columns = [{"name": "time", "type": "time", "kind": None, "bits": None}]
    columns += [{"name": name, "type": "integer", "kind": name, "bits": 64} for name in ("uint", "int", "flags")]
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables/fields.json").write_text(json.dumps({"messages": {"motor": {"columns": columns}}}))
    largest = 2**64 - 1
    (tmp_path / "tables/motor.csv").write_text(f"time,uint,int,flags\n1.000000000,{largest},{-(2**63)},{largest}\n")
    for motor in read(tmp_path, monkeypatch):
        assert [int(next(iter(motor[name]))) for name in ("uint", "int", "flags")] == [largest, -(2**63), largest]
