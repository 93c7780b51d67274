#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Tests the tests: runs them where nothing can be right, and says which pass all the same.

    blind.py                   all three ways
    blind.py silent -- ...     one of them, with arguments for pytest

    silent   a tshark that prints nothing and exits 0
    failing  a tshark that exits 2 at once
    empty    a plugin without a line of code

A test that may pass stands in tests/blind.txt, with the reason. `tshark --version` is answered: tests choose by it.
"""
import fnmatch
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml

ROOT = pathlib.Path(__file__).resolve().parents[1]
ALLOWED = ROOT / "tests/blind.txt"
EXIT_CODES = {"silent": 0, "failing": 2}
PROGRAM = """#!/bin/sh
for one in "$@"; do case $one in -v|--version) exec %s --version ;; esac; done
exit %d
"""


def allowed(way):
    """The tests that may pass in a way, as patterns with their reasons: lines of WAYS, pattern, reason, with tabs between."""
    rows = [line.split("\t") for line in ALLOWED.read_text().splitlines() if line and not line.startswith("#")]
    assert all(len(row) == 3 and row[2] for row in rows), "tests/blind.txt: each line has ways, test and reason"
    return [pattern for ways, pattern, _ in rows if way in ways.split()]


def environment(way, folder):
    if way == "empty":
        (folder / "yapp.lua").write_text(next(line for line in (ROOT / "yapp.lua").read_text().splitlines(keepends=True)
                                              if line.startswith("local VERSION")))
        shutil.copy(ROOT / "taurus_fields.lua", folder)
        (folder / "yapp").mkdir()
        return {"YAPP_PLUGIN_ROOT": str(folder)}
    program = folder / "bin/tshark"
    program.parent.mkdir()
    program.write_text(PROGRAM % (shutil.which("tshark"), EXIT_CODES[way]))
    program.chmod(0o755)
    return {"PATH": f"{program.parent}:{os.environ['PATH']}"}


def passed(way, arguments):
    """The tests that pass, as file::test[parameters]."""
    with tempfile.TemporaryDirectory(prefix="yapp-blind-") as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        subprocess.run(["pytest-3", "-q", "-n", str(os.cpu_count() + 1), "--dist", "loadgroup", "-p", "no:cacheprovider",
                        f"--junit-xml={folder}/report.xml", *arguments], cwd=ROOT, check=False,
                       stdout=subprocess.DEVNULL, env={**os.environ, **environment(way, folder)})
        cases = list(xml.parse(folder / "report.xml").getroot().iter("testcase"))
    assert cases, "no test ran"
    return len(cases), sorted(f"{case.get('classname').split('.')[-1]}::{case.get('name')}" for case in cases if len(case) == 0)


def main():
    ways, _, arguments = " ".join(sys.argv[1:]).partition(" -- ")
    problems = 0
    for way in ways.split() or [*EXIT_CODES, "empty"]:
        count, found = passed(way, arguments.split() or ["tests/e2e"])
        patterns = allowed(way)
        wrong = [name for name in found if not any(fnmatch.fnmatchcase(name, pattern.replace("[", "[[]")) for pattern in patterns)]
        print(f"blind: {way}: {count} tests, {len(found)} passed, {len(wrong)} of them are not in tests/blind.txt")
        print("".join(f"  {name}\n" for name in wrong), end="")
        problems += len(wrong)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
