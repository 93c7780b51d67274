#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Print docs/api.md, which is made of the docstrings of yapp_tables: api_page.py >docs/api.md"""
import inspect
import re
import sys
import textwrap
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "src"))  # that of this tree, installed or not
import yapp_tables as yt


def wrapped(text):
    """A docstring in lines of at most 100 columns; a paragraph of "name: meaning; name: meaning" as a list."""
    paragraphs = []
    for paragraph in re.split(r"\n\s*\n", text):
        if paragraph.startswith("    "):
            paragraphs.append(paragraph)
            continue
        paragraph = " ".join(paragraph.split())
        items = re.split(r"; (?=[a-z_]+(?:, [a-z_]+)*: )", paragraph) if re.match(r"[a-z_]+(?:, [a-z_]+)*: ", paragraph) else []
        rest = []
        if items:
            items[-1], *rest = re.split(r"(?<=\.) (?=(?:Returns|Raises|Yields|What|A) )", items[-1], maxsplit=1)
        lines = [re.sub(r"^([a-z_]+(?:, [a-z_]+)*):", r"- `\1`:", item) for item in items] or [paragraph]
        paragraphs.append("\n".join(textwrap.fill(line, 100, subsequent_indent="  " * bool(items)) for line in lines))
        paragraphs += [textwrap.fill(text, 100) for text in rest]
    return "\n\n".join(paragraphs)


def entry(name, thing):
    """A heading, the signature and the docstring."""
    signature = "" if inspect.isclass(thing) and issubclass(thing, Exception) else str(inspect.signature(thing))
    signature = re.sub(r"\b(?:collections\.abc|pathlib|yapp_tables\.\w+)\.", "", signature)
    return f"## yt.{name}\n\n    {name}{signature}\n\n{wrapped(inspect.getdoc(thing))}\n"


print("# yapp_tables in Python\n\nMade of the docstrings by `tools/api_page.py`. How to use it: [tables.md](tables.md).\n")
print(wrapped(inspect.getdoc(yt)), "\n")
print("\n".join(entry(name, getattr(yt, name)) for name in yt.__all__).rstrip())
