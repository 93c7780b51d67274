"""Two levels of tests: `make test` proves each behaviour once, `make test-all` (YAPP_DEEP=1) in every form and with every
seed.

    @levels.deep            a test, or a row of parameters (pytest.param(..., marks=levels.deep)), for test-all only
    @levels.each_once       of parameters that combine: each value once is enough for `make test`
    levels.size(80, 320)    how many random cases: in `make test`, in test-all
    @levels.together("x")   tests that share what they asked tshark for run in one process
"""
import os

import pytest

DEEP = os.environ.get("YAPP_DEEP", "") not in ("", "0")

deep = pytest.mark.deep
each_once = pytest.mark.each_once
together = pytest.mark.xdist_group


def size(some, many):
    return many if DEEP else some


def places(items):
    """Where the values of a test's parameters stand in their lists: { item: [(place, length of the list)] }."""
    values = {}
    for item in items:
        for name, value in item.callspec.params.items():
            values.setdefault(name, {}).setdefault(repr(value), len(values[name]))
    return {item: [(values[name][repr(value)], len(values[name])) for name, value in item.callspec.params.items()]
            for item in items}


def each_value(items):
    """Of a test in all combinations of its parameters: the first values together, the second ones together, and so on,
    beginning anew where a list is at its end."""
    where = places(items)
    steps = range(max(length for one in where.values() for _, length in one))
    return [item for item in items if any(all(step % length == place for place, length in where[item]) for step in steps)]


def quick(items):
    """The tests that `make test` runs."""
    kept = [item for item in items if not item.get_closest_marker("deep")]
    combined = {}
    for item in kept:
        if item.get_closest_marker("each_once"):
            combined.setdefault(item.function, []).append(item)
    chosen = {item for one in combined.values() for item in each_value(one)}
    return [item for item in kept if item.function not in combined or item in chosen]
