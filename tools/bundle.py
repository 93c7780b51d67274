#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""bundle.py [FOLDER]: yapp.lua with all its modules in it, on standard output or as FOLDER/yapp.lua beside taurus_fields.lua.

Wireshark runs each .lua file below a plugin folder as a plugin of its own, so what is installed is one file.  A module keeps
the name of its file in it, and its lines: an error says yapp/wire/crc.lua:12, as from the repository.  Comments and
indentation stay behind: to read them takes longer, at each start, than to compile what a capture without YAPP needs.
"""
import argparse
import pathlib
import re
import shutil
import sys

TOP = pathlib.Path(__file__).resolve().parent.parent

HEAD = """-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP for Wireshark, all modules in one file, made by tools/bundle.py: the sources are those files.
local folder = debug.getinfo(1, "S").source:match("^@(.*[/\\\\])") or "./"
local function chunk(name, text)
  return assert(load(text, "@" .. name))
end
local function module(name, text)
  local path = name:gsub("%.", "/") .. ".lua"
  package.preload[name] = package.preload[name] or function(...) return chunk(path, text)(...) end
end
"""


# A comment, a text, or a line break with indentation.
TOKEN = re.compile(r"""(?P<comment>--\[(=*)\[.*?\]\2\]|--[^\n]*)
  |(?P<text>\[(=*)\[.*?\]\4\]|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|\n[ \t]+""", re.S | re.X)


def shortened(source):
    """Lua source without comments and indentation, in the same lines."""
    return TOKEN.sub(lambda found: found[0] if found["text"] else "\n" * found[0].count("\n"), source)


def quoted(text):
    """A Lua long string; the line break behind its opening bracket is none of the text's."""
    level = "="
    while f"]{level}]" in text:
        level += "="
    return f"[{level}[\n{text}]{level}]"


def bundle(source=TOP):
    """The text of the one file; where it is in one file already, that."""
    if not (source / "yapp").is_dir():
        return (source / "yapp.lua").read_text(encoding="utf-8")
    modules = []
    for path in sorted((source / "yapp").rglob("*.lua")):
        name = ".".join(path.relative_to(source).with_suffix("").parts)
        modules.append(f'module("{name}", {quoted(shortened(path.read_text(encoding="utf-8")))})\n')
    main = (source / "yapp.lua").read_text(encoding="utf-8")
    return HEAD + "".join(modules) + f'return chunk(folder .. "yapp.lua", {quoted(shortened(main))})(...)\n'


def installed(source=TOP):
    """What an installation needs: { its place beside install.py: its bytes }."""
    files = {path.relative_to(source).as_posix(): path.read_bytes()
             for pattern in ("taurus_fields.lua", "extcap/*.py", "profiles/YAPP/*") for path in source.glob(pattern)}
    return {"yapp.lua": bundle(source).encode(), **files}


def write(folder, source=TOP):
    """Writes what is installed into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "yapp.lua").write_text(bundle(source), encoding="utf-8", newline="\n")
    shutil.copy(source / "taurus_fields.lua", folder / "taurus_fields.lua")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=pathlib.Path)
    if folder := parser.parse_args().folder:
        write(folder)
    else:
        sys.stdout.write(bundle())
