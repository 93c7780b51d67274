#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""make map: the folders of modules and which of them require which, as CONTRIBUTING.md shows it; with --write, into that page."""
import pathlib
import re
import sys

TOP = pathlib.Path(__file__).resolve().parent.parent

# An arrow leads down this list, or stays in a folder.  Folders of one row know nothing of each other.
ORDER = [["yapp.lua"], ["stat", "show"], ["host"], ["capture"], ["reading"], ["can", "serial"], ["file", "message"], ["wire"], ["base"]]
REQUIRE = re.compile(r'\brequire\b\s*\(?\s*"([\w.]+)"')


def files(top=TOP):
    return [top / "yapp.lua", *sorted((top / "yapp").rglob("*.lua"))]


def folder(path, top=TOP):
    """Of a module's file: "can" of yapp/can/store.lua; "yapp.lua" of the way in."""
    return "yapp.lua" if path == top / "yapp.lua" else path.parent.relative_to(top / "yapp").as_posix()


def required(path):
    """The modules of ours that a file requires: { name: line }."""
    lines = path.read_text(encoding="utf-8").split("\n")
    return {name: number for number, line in enumerate(lines, 1) for name in REQUIRE.findall(line.split("--")[0])
            if name.startswith("yapp.")}


def text(top=TOP):
    modules, arrows = {}, {}
    for path in files(top):
        here = folder(path, top)
        modules.setdefault(here, []).append(path.stem)
        arrows.setdefault(here, set()).update(name.split(".")[1] for name in required(path))
    names = [name for row in ORDER for name in row]
    lines = []
    for name in names:
        asked = " ".join(other for other in names if other in arrows[name] and other != name)
        lines.append(f"{name:9}{'─► ' + asked if asked else ''}".rstrip())
        if name != "yapp.lua":
            lines.append(f"         {' '.join(modules[name])}")
    return "".join(f"    {line}\n" for line in lines)


if __name__ == "__main__":
    print(text(), end="")
    if "--write" in sys.argv:
        page = TOP / "CONTRIBUTING.md"
        page.write_text(re.sub(r"(?m)^    yapp\.lua .*\n(?:    .*\n)*", lambda _: text(), page.read_text(), count=1))
