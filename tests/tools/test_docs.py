# SPDX-License-Identifier: GPL-2.0-or-later
"""The recipes of docs/tables.md and docs/compare.md, run in order as a user would, with the plugin installed."""

import os
import re
import subprocess
import sys
import tomllib

import flights
import numpy as np
import pairs
import pyarrow.parquet as pq
import pytest
import yapp_tables as yt
from running import PLUGIN, TOP, install_plugin

BLOCKS = re.findall(r"^```(sh|python)\n(.*?)^```", (TOP / "docs/tables.md").read_text(), re.M | re.S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("docs")
    flights.write(folder / "run.pcapng", 1, 30)
    for seed in range(3):
        path = folder / f"flights/ac{seed:02}/flight{seed}.pcapng"
        path.parent.mkdir(parents=True)
        flights.write(path, seed, 20)
    install_plugin(folder / "home")
    (folder / "docs").symlink_to(TOP / "docs")
    return folder


def run(folder, language, text, code=0):
    """Run a recipe in the folder; return what it printed."""
    path = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"
    environment = os.environ | {"HOME": str(folder / "home"), "PATH": path}
    command = ["bash", "-euo", "pipefail", "-c", text] if language == "sh" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_recipe(folder, number):
    language, text = BLOCKS[number]
    printed = run(folder, language, text)
    assert language == "sh" or printed.strip()


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """What docs/compare.md speaks of: two runs, five flights, one controller on a thrust stand with its log."""
    own = tmp_path_factory.mktemp("compare")
    (own / "home/.config/wireshark").mkdir(parents=True)
    install_plugin(own / "home")
    (own / "home/.config/wireshark/preferences").write_text(
        "yapp.motor_ids: 0x210,0x211\nyapp.health_ids: 0x200,0x201\n"
    )
    (own / "tests").symlink_to(TOP / "tests")
    (own / "flights").mkdir()
    for number in range(5):
        pairs.write(own / f"flights/{number}.pcapng", f"trend {number}", (), 40.0, number * 3600.0)
    with pytest.MonkeyPatch.context() as patch:
        run = pairs.Motor.run
        patch.setattr(pairs.Motor, "run", lambda self, *given: run(self, *given) if self.number == 0 else ())
        pairs.write(own / "bench.pcapng", "bench", seconds=60)
    motor = yt.read(own / "bench.pcapng", plugin=PLUGIN)["motor"]
    times = motor["time"].cast("int64").to_numpy() / 1e9 - flights.START / 1e9
    at = np.arange(3, 55, 0.05)
    speeds = np.interp(at, times, motor["rpm_measured"].to_numpy())
    lines = [f"{time - 3:.3f},{speed:.1f}" for time, speed in zip(at, speeds, strict=True)]
    (own / "stand.csv").write_text("\n".join(["time,rpm", *lines, ""]))
    return own


COMPARED = re.findall(r"^```sh\n(.*?)^```", (TOP / "docs/compare.md").read_text(), re.M | re.S)


@pytest.mark.parametrize("number", range(len(COMPARED)))
def test_commands_of_the_comparison(compared, number):
    printed = run(compared, "sh", COMPARED[number], code=20 * ("diff" in COMPARED[number]))
    page = re.search(r"--out (\w+\.html)", COMPARED[number])
    assert not page or "</html>" in (compared / page[1]).read_text()
    assert printed.strip() or "--to parquet" in COMPARED[number]
    if "--with" in COMPARED[number]:
        points = pq.read_table(compared / "bench/message=points").to_pylist()
        known = [row for row in points if row["bench_rpm"] is not None]
        assert len(known) >= 2
        assert [row["bench_rpm"] for row in known] == pytest.approx([row["rpm_measured"] for row in known], rel=0.01)


def test_recipes_keep_captures_that_name_no_bus(folder, tmp_path):
    """In SQL and in pandas, null equals nothing."""
    command = ["tshark", "-r", folder / "run.pcapng", "-Y", "frame.interface_id == 0", "-F", "pcap"]
    subprocess.run([*command, "-w", tmp_path / "run.pcap"], check=True)
    (tmp_path / "home").symlink_to(folder / "home")
    (notebook,) = (text for _, text in BLOCKS if "groupby([" in text)
    assert "\nNaN 528 " in run(tmp_path, "python", notebook.replace("run.pcapng", "run.pcap"))
    (convert,) = (text for _, text in BLOCKS if text.startswith("yapp-tables convert 'flights") and "parquet" in text)
    run(tmp_path, "sh", convert.replace("flights/**/*.pcapng", "run.pcap"))
    (questions,) = (text for _, text in BLOCKS if "ASOF JOIN" in text)
    assert "0 rows" not in run(tmp_path, "python", questions)


def test_all_and_recipes_bring_what_the_recipes_use():
    extras = tomllib.loads((TOP / "tools/pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted, brought = ["all", "recipes"], set()
    for extra in wanted:
        for requirement in extras[extra]:
            name, more = re.match(r"([\w-]+)(?:\[(.*)\])?", requirement).groups()
            wanted += more.split(",") if name == "yapp-tables" else []
            brought.add(name)
    used = set(re.findall(r"^(?:import|from) (\w+)", "\n".join(text for _, text in BLOCKS), re.M))
    assert used - {"yapp_tables", *sys.stdlib_module_names} <= brought
    assert "pytz" in brought  # duckdb makes times with it, and does not bring it


@pytest.mark.parametrize("page", ["api", "columns"])
def test_a_page_is_that_of_the_code(page):
    done = subprocess.run([sys.executable, TOP / f"tools/{page}_page.py"], capture_output=True, text=True, check=True)
    assert (TOP / f"docs/{page}.md").read_text() == done.stdout, "run make regenerate"
