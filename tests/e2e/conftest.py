# SPDX-License-Identifier: GPL-2.0-or-later
import os
import pathlib
import shutil
import sys

import pytest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "test_captures")]
import levels  # noqa: E402
import tshark  # noqa: E402

# A tshark asks for its memory in few large pieces: a seventh of its start, and most tests start one.
os.environ.setdefault("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1")
os.environ.setdefault("MALLOC_TOP_PAD_", str(64 << 20))


def pytest_configure(config):
    for line in levels.MARKERS:
        config.addinivalue_line("markers", line)


def pytest_collection_modifyitems(config, items):
    if not any("::" in argument for argument in config.args):  # a test that is asked for by name runs
        chosen = levels.chosen(items)
        config.hook.pytest_deselected(items=sorted(set(items) - set(chosen), key=items.index))
        items[:] = chosen


@pytest.fixture
def folder():
    path = tshark.writable_folder()
    yield path
    shutil.rmtree(path, ignore_errors=True)
