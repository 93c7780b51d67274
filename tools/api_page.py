#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Print docs/api.md, which is made of the docstrings of yapp_tables: api_page.py >docs/api.md"""
import inspect

import yapp_tables as yt


def entry(name, thing):
    """A heading, the signature and the docstring."""
    signature = "" if inspect.isclass(thing) and issubclass(thing, Exception) else inspect.signature(thing)
    return f"## yt.{name}\n\n    {name}{signature}\n\n{inspect.getdoc(thing)}\n"


print("# yapp_tables in Python\n\nMade of the docstrings by `tools/api_page.py`. How to use it: [tables.md](tables.md).\n")
print(inspect.getdoc(yt.api), "\n")
print("\n".join(entry(name, getattr(yt, name)) for name in yt.__all__).rstrip())
