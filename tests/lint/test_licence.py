# SPDX-License-Identifier: GPL-2.0-or-later
"""Every source file names its licence."""
import pathlib
import subprocess
import sys

SPDX = pathlib.Path(__file__).resolve().parents[2] / "tools" / "spdx.py"


def check(tool):
    return subprocess.run([sys.executable, tool, "--check"], capture_output=True, text=True, check=False)


def test_every_source_file_names_its_licence():
    done = check(SPDX)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_file_without_one_is_named(tmp_path):
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "spdx.py").write_text(SPDX.read_text())
    (tmp_path / "without.lua").write_text("return {}\n")
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    subprocess.run(["git", "-C", tmp_path, "add", "."], check=True)
    done = check(tmp_path / "tools" / "spdx.py")
    assert (done.returncode, done.stdout) == (1, "without.lua\n"), done.stderr
