# SPDX-License-Identifier: GPL-2.0-or-later
"""Functions of the plugin are short. (Their branches: .luacheckrc.)"""
import pathlib
import re
import subprocess

import pytest

TOP = pathlib.Path(__file__).resolve().parents[2]
FILES = [TOP / "yapp.lua", *sorted((TOP / "yapp").rglob("*.lua"))]
MAX_LINES = 60


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(TOP).as_posix())
def test_lengths(path):
    listed = subprocess.run(["luac5.4", "-l", "-p", path], capture_output=True, text=True, check=True).stdout
    functions = [(int(first), int(last)) for first, last in re.findall(r"^function <.*:(\d+),(\d+)>", listed, re.M)]
    assert functions or not re.search(r"^(local )?function\b", path.read_text(encoding="utf-8"), re.M)
    assert [first for first, last in functions if last - first >= MAX_LINES] == [], "lines where a long function begins"
