# SPDX-License-Identifier: GPL-2.0-or-later
"""No published name vanishes or changes; a new one is a line of tests/published.txt."""
import re

import pytest

import levels
import model
import published
import tshark

pytestmark = levels.by_route


def test_published_names():
    assert published.differences(published.read(), published.names(published.inventory())) == [], \
        "+ is new: run make regenerate; - has vanished or changed: published names stay"


def test_the_inventory_says_what_wireshark_has():
    """Fields with their types, preferences with their defaults."""
    load = tshark.load(tshark.PLUGIN / "yapp.lua")
    rows = [line.split("\t") for line in tshark.run("-G", "fields", *load, plugin=False).stdout.splitlines()]
    types = {row[2]: row[3] for row in rows if row[0] == "F" and row[2].startswith(("yapp.", "taurus."))}
    wanted = published.of("field") | dict.fromkeys(published.of("expert"), "NONE")
    assert types == {name: f"FT_{kind}" for name, kind in wanted.items()}
    shown = tshark.run("-G", "currentprefs", *load, plugin=False).stdout
    values = dict(re.findall(r"(?m)^#?(yapp\.\w+): *(.*)$", shown))
    assert values.keys() == published.of("preference").keys()
    for name, line in published.of("preference").items():
        kind, _, default = line.partition(" ")
        if kind == "range":
            assert values[name] == (str(int(default, 0)) if default else "")
        elif kind != "enum":
            assert values[name] == (default.upper() if kind == "bool" else default)
    assert values["yapp.divisor"] == "2^N - 6 (mapping)"
    periods = ", ".join(f"{message[1]} {message.every:g} s" for message in model.MESSAGES.values() if message.every)
    assert f"Periods: {periods}." in shown


@levels.without_tshark("compares two tables of the tests")
def test_the_vendors_names():
    """What follows from the tables of the document is there."""
    assert dict(model.filters().items() - published.of("field").items()) == {}, "as MESSAGES in model.py has them"
    assert all(f"yapp.{message.name}_ids" in published.of("preference") for message in model.MESSAGES.values())


def test_every_field_says_what_it_is():
    about = {row["name"]: row["help"] for row in published.inventory()["fields"]}
    assert [name for name, text in about.items() if not text] == []


def test_the_page_of_columns():
    """docs/columns.md, which yapp-tables makes, says what each column is."""
    tables, page = published.inventory()["statistics"], (tshark.ROOT / "docs/columns.md").read_text()
    columns = [column for name in ("summary", "faults", "events") for column in tables[name]["columns"]]
    assert [one["name"] for one in columns if one["help"] not in page and one["type"] != "values"] == [], "run make regenerate"


@pytest.mark.parametrize("sort", ["rules", "kinds", "statistics", "preferences"])
def test_every_row_says_what_it_is(sort):
    rows = published.inventory()[sort]
    assert all((row.get("help") or row.get("text")).strip() for row in (rows.values() if isinstance(rows, dict) else rows))
