# SPDX-License-Identifier: GPL-2.0-or-later
"""The recipes of docs/tables.md, run in order as a user would, with the plugin in the personal folder."""

import os
import re
import subprocess
import sys
import tomllib

import flights
import pytest
from running import TOP, install_plugin

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
    return folder


def run(folder, language, text):
    """Run a recipe in the folder; return what it printed."""
    path = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"
    environment = os.environ | {"HOME": str(folder / "home"), "PATH": path}
    command = ["bash", "-euo", "pipefail", "-c", text] if language == "sh" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_recipe(folder, number):
    language, text = BLOCKS[number]
    printed = run(folder, language, text)
    assert language == "sh" or printed.strip()


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


def test_the_package_has_the_plugins_version():
    plugin = re.search(r'^local VERSION = "(.*)"', (TOP / "yapp.lua").read_text(), re.M)
    package = re.search(r'^version = "(.*)"', (TOP / "tools/pyproject.toml").read_text(), re.M)
    assert package[1] == plugin[1]


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
