#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Write docs/filters.md, the reference of all filter names, from what tshark says of the plugin: filters_page.py [FILE]
Without a FILE, the rules of a message in docs/rules.md, too.

`tshark -G fields` has names, types, titles and descriptions, `-G values` the meanings of numbers,
`-G currentprefs` the preferences. For -G tshark loads plugins from a plugin folder only, so the plugin is copied into an
empty home.
"""
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap

TOP = pathlib.Path(__file__).resolve().parents[1]
FILTERS, RULES = TOP / "docs/filters.md", TOP / "docs/rules.md"
PLUGIN = ("yapp.lua", "taurus_fields.lua", "yapp")
ROOT_IS_REFUSED = os.geteuid() == 0  # Wireshark 4.4 and later run no plugin as root
HEAD = """# Filters

Every name that the plugin adds to Wireshark's display filters. Published names never change.
`make regenerate` writes this page from what `tshark -G fields` says of the plugin.

- **flag**: a field of one bit; `NAME == 1` finds the messages in which the bit is set.
- **expert item**: a remark on a packet; `NAME` alone finds the packets that have it.
- `NAME.special`: why a field has no value: 0 NaN, 1 +infinity, 2 -infinity, 3 above range,
  4 below range.
- Fields of your own messages (`yapp_messages.lua`) are `taurus.MESSAGE.FIELD`.
"""
TYPES = {"FT_NONE": "-", "FT_BYTES": "bytes", "FT_STRING": "text", "FT_BOOLEAN": "flag", "FT_DOUBLE": "number",
         "FT_FRAMENUM": "frame", "FT_RELATIVE_TIME": "time"}
PROTOCOLS = {
    "yapp": "YAPP on CAN: the IDs that the catalogue and the preferences name",
    "yapp_all": "every other extended CAN frame, by *Decode As* or `yapp.all_extended`",
    "yapp_serial": "YAPP in a byte stream: UART, TCP, UDP",
    "taurus": "the messages of Taurus controllers",
}


def ask(home, what):
    """What `tshark -G WHAT` prints with the plugin installed in this home."""
    user = {"user": 65534, "group": 65534, "extra_groups": []} if ROOT_IS_REFUSED else {}
    environment = {"PATH": os.environ["PATH"], "HOME": str(home), "LC_ALL": "C.UTF-8"}
    done = subprocess.run(["tshark", "-G", what], env=environment, stdout=subprocess.PIPE,
                          stderr=subprocess.DEVNULL, check=True, **user)
    return done.stdout.decode()


def inventory(home):
    """fields.json, which the plugin writes beside its tables."""
    user = {"user": 65534, "group": 65534, "extra_groups": []} if ROOT_IS_REFUSED else {}
    environment = {"PATH": os.environ["PATH"], "HOME": str(home), "LC_ALL": "C.UTF-8"}
    (home / "tables").mkdir(mode=0o777)
    (home / "tables").chmod(0o777)
    subprocess.run(["tshark", "-q", "-r", home / "run.pcapng", "-z", f"yapp,csv,{home}/tables"], env=environment, check=True,
                   stdout=subprocess.DEVNULL, **user)
    return json.loads((home / "tables/fields.json").read_text(encoding="utf-8"))


def cell(text):
    return text.replace("|", "\\|")


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(cell, row)) + " |" for row in lines) + "\n"


def fields(text):
    """-> [(name, type, mask, title, description)] of the plugin, in the order in which it makes them."""
    rows = [line.split("\t") for line in text.split("\n") if line.startswith("F\t") and ("\tyapp" in line or "\ttaurus" in line)]
    return [(row[2], row[3], int(row[6] or "0", 16), row[1], row[7].strip())
            for row in rows if row[4] in ("yapp", "taurus")]


def meanings(text):
    """-> { name: "0 Bad, 1 Good" }"""
    found = {}
    for row in (line.split("\t") for line in text.split("\n") if line.startswith(("V\tyapp.", "V\ttaurus."))):
        found.setdefault(row[1], []).append(f"{int(row[2], 0)} {row[3]}")
    return {name: ", ".join(texts) for name, texts in found.items()}


def preferences(text):
    """-> a section for each preference"""
    text = text.replace("# Equivalently, one of:", "# One of:")  # of 4.6, behind a line of short names
    found = re.findall(r"^# (.*)\n# .*\n#?(yapp\.\w+): ?(.*)$", text, re.M)
    return [f"\n### `{name}`\n\nDefault: {f'`{value}`' if value else 'empty'}.\n\n"
            f"{textwrap.fill(about, 100, break_on_hyphens=False)}\n" for about, name, value in found]


def page(home, found):
    known, values = fields(ask(home, "fields")), meanings(ask(home, "values"))
    has_description = [row for row in known if row[4]]
    experts = sorted((f"`{name}`", title) for name, kind, _, title, about in known if kind == "FT_NONE" and not about)
    parts = [HEAD, "\n## Protocols\n\n`yapp` finds YAPP of all three dissectors. `yapp_all` and `yapp_serial` are names for\n*Decode As* and `frame.protocols`, no filters.\n\n",
             table(["protocol", "what it is"], [(f"`{name}`", about) for name, about in PROTOCOLS.items()])]
    groups = {}
    for name, kind, mask, title, about in has_description:
        if name.endswith(".special"):
            continue
        group = "yapp" if name.startswith("yapp.") else ".".join(name.split(".")[:2])
        what = TYPES.get(kind) or kind[3:].lower()
        text = f"{title} (0x{mask:x})" if kind == "FT_BOOLEAN" and mask else about
        if name in values and kind != "FT_BOOLEAN" and name != "yapp.id":
            text += f": {values[name]}"
        groups.setdefault(group, []).append((f"`{name}`", what, text))
    for group, rows in sorted(groups.items(), key=lambda one: (one[0] != "yapp", one[0])):
        parts += [f"\n## Fields of {group}\n\n", table(["filter", "type", "meaning"], sorted(rows))]
    parts += ["\n## Expert items\n\n`tshark -z expert` counts them.\n\n", table(["filter", "meaning"], experts)]
    kinds = [(f"`{row['name']}`", row["text"], f"`{row['keys']}`" if row["keys"] else "") for row in found["kinds"]]
    parts += ["\n## Events\n\nThe kinds of `-z yapp,events`, with their keys in JSON. `NAME=N` is a [rule](rules.md#rules).\n\n",
              table(["kind", "text", "keys"], kinds)]
    parts += ["\n## Preferences\n\n*Preferences > Protocols > YAPP*, or `-o NAME:VALUE`.\n",
              *preferences(ask(home, "currentprefs"))]
    return "".join(parts)


def main(target):
    with tempfile.TemporaryDirectory() as folder:
        home = pathlib.Path(folder)
        plugins = home / ".local/lib/wireshark/plugins/yapp"
        plugins.mkdir(parents=True)
        for name in PLUGIN:
            source = TOP / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, plugins / name)
        shutil.copy(TOP / "docs/first.pcapng", home / "run.pcapng")
        for path in [home, *home.rglob("*")]:
            path.chmod(0o755)
        found = inventory(home)
        target.write_text(page(home, found), encoding="utf-8")
    if target == FILTERS:
        rules = table(["rule of a message", "holds if, for each source,"], [(f"`{row['text']}`", row["help"]) for row in found["rules"]])
        before, head, after = RULES.read_text(encoding="utf-8").partition("| rule of a message ")
        assert head, "docs/rules.md has no table of the rules of a message"
        RULES.write_text(before + rules + "\n" + after.partition("\n\n")[2], encoding="utf-8")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else FILTERS)
