# SPDX-License-Identifier: GPL-2.0-or-later
"""How much the tests do: YAPP_LEVEL says it.

    quick      each behaviour once: `make test`
    route      of these, what may depend on how the plugin was loaded: `make test-all`, by the other route on each version
    version    each behaviour once, all combinations of what may depend on Wireshark's version, all random cases:
               `make test-all`, on each version
    all        everything: `make test-all`, on this machine's version

What the tests say of themselves, each by itself or a whole file by pytestmark = [...]:

    @levels.deep            only where everything is done; so does a row, pytest.param(..., marks=levels.deep)
    @levels.each_once       of parameters that combine: each value once is enough for quick
    @levels.by_version      not less in version than in all
    @levels.by_route        done in route
    @levels.together("x")   tests that share what they asked tshark for run in one process
    levels.size(80, 320)    so many random cases: 320 only where everything is done
    levels.few(rows, some)  of a test's rows, these in every level, the others as if deep
"""
import os

import pytest

LEVEL = os.environ.get("YAPP_LEVEL") or "quick"
assert LEVEL in ("quick", "route", "version", "all"), f"YAPP_LEVEL is {LEVEL}"
ALL = LEVEL == "all"

deep = pytest.mark.deep
each_once = pytest.mark.each_once
by_version = pytest.mark.by_version
by_route = pytest.mark.by_route
together = pytest.mark.xdist_group
without_tshark = pytest.mark.without_tshark  # why: tests/blind.py leaves it out

MARKERS = ["deep: only in the level all", "each_once: in the level quick each value once", "by_version: all in the level version",
           "by_route: in the level route", "xdist_group(name): in one process",
           "without_tshark(why): passes whatever tshark does"]


def size(some, many):
    return many if ALL else some


def few(rows, some, several=False):
    """several: a row is the values of several parameters."""
    assert all(one in rows for one in some), f"{some} are not all in {rows}"
    return [row if row in some else pytest.param(*(row if several else [row]), marks=deep) for row in rows]


def each_value(items):
    """Of a test in all combinations of its parameters some that have each value: first those all of whose values are new."""
    seen, once = set(), []
    for has_new in (all, any):
        for item in items:
            values = {(name, repr(value)) for name, value in item.callspec.params.items()}
            if has_new(value not in seen for value in values):
                once.append(item)
                seen |= values
    return once


def chosen(items):
    """The tests of this level."""
    def is_whole(item):
        return ALL or LEVEL == "version" and item.get_closest_marker("by_version")

    kept = [item for item in items if is_whole(item) or not item.get_closest_marker("deep")]
    combined = {}
    for item in kept:
        if item.get_closest_marker("each_once") and not is_whole(item):
            combined.setdefault(item.function, []).append(item)
    once = {item for one in combined.values() for item in each_value(one)}
    return [item for item in kept if (item.function not in combined or item in once) and
            (LEVEL != "route" or item.get_closest_marker("by_route"))]
