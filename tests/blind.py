#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Tests the tests: runs them where nothing can be right, and says which pass all the same.

    blind.py                   silent and failing: fails where a test passes
    blind.py empty -- ...      one way, with arguments for pytest

    silent   a tshark that prints nothing and exits 0
    failing  a tshark that exits 2 at once
    empty    a plugin without a line of code

A test that runs no tshark passes, too, and says why: `@levels.without_tshark("computes with figures of its own")`.
`tshark --version` is answered: tests choose by it.
"""
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as xml

ROOT = pathlib.Path(__file__).resolve().parents[1]
EXIT_CODES = {"silent": 0, "failing": 2}
PROGRAM = """#!/bin/sh
for one in "$@"; do case $one in -v|--version) exec %s --version ;; esac; done
exit %d
"""


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
                        f"--junit-xml={folder}/report.xml", "-m", "not without_tshark", *arguments], cwd=ROOT, check=False,
                       stdout=subprocess.DEVNULL, env={**os.environ, **environment(way, folder)})
        cases = list(xml.parse(folder / "report.xml").getroot().iter("testcase"))
    assert cases, "no test ran"
    return len(cases), sorted(f"{case.get('classname').split('.')[-1]}::{case.get('name')}" for case in cases if len(case) == 0)


def main():
    ways, _, arguments = " ".join(sys.argv[1:]).partition(" -- ")
    is_bad = False
    for way in ways.split() or EXIT_CODES:
        count, found = passed(way, arguments.split() or ["tests/e2e"])
        print("".join(f"  {name}\n" for name in found), end="")
        print(f"blind: {way}: {len(found)} of {count} tests pass")
        is_bad = is_bad or bool(found)
    return 1 if is_bad else 0


if __name__ == "__main__":
    sys.exit(main())
