#!/usr/bin/env python3
"""Gives every source file its licence line, behind "#!": spdx.py; spdx.py --check only names the files without one."""
import pathlib
import subprocess
import sys

TOP = pathlib.Path(__file__).resolve().parents[1]
# REUSE-IgnoreStart
TEXT = "SPDX-License-Identifier: GPL-2.0-or-later"
# REUSE-IgnoreEnd
NAMES = ("Makefile", ".luacheckrc")
NOT_OURS = ("test_captures/fuzz/",)


def sources():
    """The tracked files that are programs: by their ending, their name, or their first line."""
    listed = subprocess.run(["git", "-c", "safe.directory=*", "ls-files", "-z"], cwd=TOP, stdout=subprocess.PIPE, check=True)
    for name in listed.stdout.decode().split("\0")[:-1]:
        path = TOP / name
        if name.startswith(NOT_OURS) or not path.is_file():
            continue
        start = path.read_bytes()[:2]
        if path.suffix in (".lua", ".py", ".sh", ".yml") or path.name in NAMES or (not path.suffix and start == b"#!"):
            yield path


def comment(path):
    return "--" if path.suffix == ".lua" or path.name == ".luacheckrc" else "#"


def main():
    missing = [path for path in sources() if TEXT not in path.read_text(encoding="utf-8")[:400]]
    for path in missing:
        if "--check" in sys.argv:
            print(path.relative_to(TOP))
            continue
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        lines.insert(1 if lines and lines[0].startswith("#!") else 0, f"{comment(path)} {TEXT}\n")
        path.write_text("".join(lines), encoding="utf-8")
    return 1 if missing and "--check" in sys.argv else 0


if __name__ == "__main__":
    sys.exit(main())
