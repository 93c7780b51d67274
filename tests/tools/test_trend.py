# SPDX-License-Identifier: GPL-2.0-or-later
"""What drifts over flights is found, and nothing else; few flights say nothing.

test_trend.py FOLDER COUNT judges so many flights.
"""

import json
import random
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pairs
import pytest
from running import PLUGIN, run_tables

# Of which controller, and by how much over all flights.
DRIFTS = {
    0: ("current", 0.05, "DC Current"),
    1: ("temperature", 7.0, "Motor Temperature"),
    2: ("lag", 70.0, "response"),
}


def write(folder, count, drifts=DRIFTS):
    """Write flights an hour apart."""
    (folder / "flights").mkdir()

    def one(number):
        share = number / max(count - 1, 1)
        changes = {who: {kind: size * share} for who, (kind, size, _) in drifts.items()}
        seconds = random.Random(f"seconds {number}").uniform(35, 55)
        path = folder / f"flights/{number:03}.pcapng"
        pairs.write(path, f"trend {number}", changes, seconds, number * 3600.0)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(one, range(count)))
    command = ["convert", "flights/*.pcapng", "--to", "parquet", "--out", "data", "--plugin", PLUGIN, *pairs.OPTIONS]
    run_tables(folder, *command, timeout=3600, code=0)
    return folder


def trend(folder, *more):
    return run_tables(folder, "trend", "data", *more, timeout=3600, code=0).stdout


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write(tmp_path_factory.mktemp("trend"), 16)


def judge(rows):
    """The planted drifts that were found with their size within 30 %, and those that nobody planted."""
    sure = [row for row in rows if row["is_sure"]]
    names = list(pairs.NAMES.values())
    found, known = [], []
    for who, (kind, size, word) in DRIFTS.items():
        own = [row for row in sure if row["controller"] == names[who] and word in row["title"]]
        size = size / 1000 if kind == "lag" else size
        found += [kind for row in own if abs(row["per_flight"] * (row["flights"] - 1) / size - 1) < 0.3][:1]
        known += own
    # Torque IQ is 1.2 times the current; a lag shows nowhere else.
    return found, [row for row in sure if row not in known and "Torque IQ" not in row["title"]]


def test_planted_drifts_are_found_and_none_is_invented(data):
    rows = list(map(json.loads, trend(data, "--json", "--out", "trend.html").splitlines()))
    assert judge(rows) == ([kind for kind, *_ in DRIFTS.values()], [])
    for row in rows:
        assert row["low"] <= row["per_flight"] <= row["high"]
    page = (data / "trend.html").read_text()
    assert page.count("<svg") == len(rows)
    assert page.count("<line class=sure") == sum(row["is_sure"] for row in rows)
    assert "fl: DC Current +" in trend(data)


def test_four_flights_say_nothing(data, tmp_path):
    (tmp_path / "few").mkdir()
    names = " ".join(f"{data}/flights/{number:03}.pcapng" for number in (0, 5, 10, 15)).split()
    run_tables(tmp_path, "convert", *names, "--to", "parquet", "--out", "data", "--plugin", PLUGIN, *pairs.OPTIONS)
    said = trend(tmp_path)
    assert "fl: fewer than 5 comparable flights, no trend" in said
    assert said.endswith("0 drifts in 0 values of controllers\n")


def test_what_is_no_data_set(tmp_path):
    done = run_tables(tmp_path, "trend", ".")
    assert (done.returncode, "no data set of Parquet files: yapp-tables convert" in done.stderr) == (2, True)
    (tmp_path / "message=flights").mkdir()
    (tmp_path / "message=flights/one.parquet").write_text("damaged")
    done = run_tables(tmp_path, "trend", ".")
    assert (done.returncode, "one.parquet is damaged: remove it" in done.stderr) == (2, True), done.stderr


if __name__ == "__main__":
    folder, count = Path(sys.argv[1]), int(sys.argv[2])
    write(folder, count)
    print(trend(folder))
    print(judge(list(map(json.loads, trend(folder, "--json").splitlines()))))
