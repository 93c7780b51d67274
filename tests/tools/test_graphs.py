# SPDX-License-Identifier: GPL-2.0-or-later
"""yapp-tables graphs: the profile's graphs, a line of each controller, in the form that Wireshark reads."""

import csv
from pathlib import Path

import flights
import pytest
from running import PLUGIN, run_tables

ROOT = Path(__file__).parents[2]


def rows_of(path):
    return list(csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#")))


@pytest.fixture(scope="module")
def eight(tmp_path_factory):
    """A flight of eight controllers, one of which falls silent; some have names."""
    folder = tmp_path_factory.mktemp("graphs")
    flights.write(folder / "eight.pcapng", 5, 10, plans=flights.EIGHT)
    names = "yapp.sources:can0/0x210-0x213=motor:M1..M4"
    options = ["-o", names, "-o", "yapp.motor_ids:0x210-0x213", "-o", "yapp.health_ids:0x200-0x203"]
    done = run_tables(folder, "graphs", "eight.pcapng", "--out", ".", *options, "--plugin", PLUGIN)
    assert done.returncode == 0, done.stderr
    return folder, done.stderr


def test_each_row_on_motor_data_is_there_once_for_each_controller(eight):
    folder, said = eight
    named = ["M1", "M2", "M3", "M4", *(f"can1 {0x210 + n:#x}" for n in range(4))]
    assert ", ".join(named) in said
    for name, title in (("io_graphs", 1), ("plots", 2)):
        before, rows = rows_of(ROOT / "profiles/YAPP" / name), rows_of(folder / name)
        of_motor = [row for row in before if any(cell.startswith("taurus.motor.") for cell in row)]
        assert len(of_motor) >= 6
        assert len(rows) == len(before) + 7 * len(of_motor)
        measured = [row for row in rows if row[title].startswith("RPM measured ") and "lowest" not in row[title]]
        assert [row[title] for row in measured] == [f"RPM measured {one}" for one in named]
        assert len({row[title + 2] for row in measured}) == 8, "a colour for each"
        assert measured[0][title + 1] == r"yapp.source == \x22M1\x22 && !yapp.crc.bad"
        assert measured[5][title + 1] == r"yapp.bus == \x22can1\x22 && yapp.id == 0x211 && !yapp.crc.bad"
        rest = [row for row in before if row not in of_motor]
        assert [row for row in rows if row in rest] == rest


def test_where_nothing_can_be_written(eight):
    folder, _ = eight
    done = run_tables(folder, "graphs", "eight.pcapng", "--out", "nowhere", "--plugin", PLUGIN)
    assert done.returncode == 2
    assert "no folder nowhere" in done.stderr
