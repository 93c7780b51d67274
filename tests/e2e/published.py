# SPDX-License-Identifier: GPL-2.0-or-later
"""The published names: tests/published.txt, beside what the plugin describes of itself, fields.json.

A line is a sort of name, the name, and what programs rely on: its type, or the like.  A line that vanishes or changes breaks
what somebody wrote, so a person alone takes one out or changes it.  A new name is a new line.

    published.py         prints the lines that the plugin has and the file has not, and the other way round
    published.py --add   adds new ones to the file, as make regenerate does
"""
import functools
import json
import pathlib
import shutil
import sys

import tshark

FILE = pathlib.Path(__file__).resolve().parents[1] / "published.txt"


@functools.lru_cache(None)
def inventory():
    """fields.json of the plugin."""
    folder = tshark.writable_folder()
    tshark.run("-q", "-r", tshark.CAPTURES / "can/document_command.pcap", "-z", f"yapp,csv,{folder / 'tables'}")
    found = json.loads((folder / "tables/fields.json").read_text())
    shutil.rmtree(folder)
    return found


def names(found):
    """The names of an inventory: { (sort, name): type }."""
    def of(sort, rows, *keys, name="name", before=""):
        return {(sort, before + row[name]): " ".join(str(row[key]) for key in keys if row[key] not in (None, "")) for row in rows}

    lines = of("field", found["fields"], "type") | of("expert", found["experts"], "group", "severity")
    lines |= of("preference", found["preferences"], "type", "default", before="yapp.") | of("rule", found["rules"], name="text")
    for row in found["kinds"]:
        words = [f"{key}={row[key].replace(' ', ',')}" for key in ("keys", "counts_as", "scope") if row[key]]
        lines["kind", row["name"]] = " ".join(words + [key for key in ("is_optional", "is_counted_only") if row[key]])
    for name, statistic in found["statistics"].items():
        lines["statistic", name] = statistic["options"]
        lines |= of("key", statistic["columns"], "type", "unit", before=f"{name}.")
    for name, message in found["messages"].items():
        lines |= of("column", message["columns"], "type", "unit", before=f"{name}.")
        lines |= of("formula", message["formulas"], "of", "operator", "less", before=f"{name}.")
    return lines


@functools.lru_cache(None)
def read():
    """The names of the file, as names() has them."""
    lines = [line.split(None, 2) for line in FILE.read_text().splitlines() if line and not line.startswith("#")]
    found = {(sort, name): " ".join(rest) for sort, name, *rest in lines}
    assert len(found) == len(lines), "a name stands twice in published.txt"
    return found


def of(sort):
    """The names of one sort, with their types."""
    return {name: rest for (one, name), rest in read().items() if one == sort}


def differences(written, there):
    """Lines with a sign in front: - is published and not there, + is there and not published."""
    rows = [(name, sign, one[name]) for sign, one, other in (("-", written, there), ("+", there, written))
            for name in one if one[name] != other.get(name)]
    return [f"{sign} {' '.join(name)} {rest}".rstrip() for name, sign, rest in sorted(rows)]


def add():
    """Add the lines of new names to the file, each sort behind its own."""
    lines, there = FILE.read_text().splitlines(), names(inventory())
    for (sort, name), rest in there.items():
        if (sort, name) not in read():
            same = [at for at, line in enumerate(lines) if line.startswith(f"{sort} ")] or [len(lines) - 1]
            lines.insert(same[-1] + 1, f"{sort} {name} {rest}".rstrip())
    FILE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    if "--add" in sys.argv:
        add()
    else:
        print("\n".join(differences(read(), names(inventory()))))
