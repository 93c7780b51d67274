# SPDX-License-Identifier: GPL-2.0-or-later
"""The recipes of docs/tables.md, run in order as a user would, with the plugin in the personal folder."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import flights
import pytest
from running import PLUGIN

BLOCKS = re.findall(
    r"^```(sh|python)\n(.*?)^```", (Path(__file__).parents[2] / "docs/tables.md").read_text(), re.M | re.S
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("docs")
    flights.write(folder / "flight.pcapng", 1, 30)
    for seed in range(3):
        path = folder / f"flights/ac{seed:02}/flight{seed}.pcapng"
        path.parent.mkdir(parents=True)
        flights.write(path, seed, 20)
    plugin = Path(PLUGIN).parent
    installed = folder / "home/.local/lib/wireshark/plugins/yapp"
    installed.mkdir(parents=True)
    for name in ("yapp.lua", "taurus_fields.lua"):
        shutil.copy(plugin / name, installed)
    shutil.copytree(plugin / "yapp", installed / "yapp")
    return folder


@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_recipe(folder, number):
    language, text = BLOCKS[number]
    path = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"
    environment = os.environ | {"HOME": str(folder / "home"), "PATH": path}
    command = ["bash", "-euo", "pipefail", "-c", text] if language == "sh" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    if language == "python":
        assert done.stdout.strip()


def test_the_package_has_the_plugins_version():
    top = Path(__file__).parents[2]
    plugin = re.search(r'^local VERSION = "(.*)"', (top / "yapp.lua").read_text(), re.M)
    package = re.search(r'^version = "(.*)"', (top / "tools/pyproject.toml").read_text(), re.M)
    assert package[1] == plugin[1]
