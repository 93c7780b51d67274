# SPDX-License-Identifier: GPL-2.0-or-later
"""What tests the tests: the list of mutants that no test can tell from the module names lines that are there; which test failed."""
import pathlib
import sys

import pytest

TOP = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "tests"))
import witnesses  # noqa: E402


def test_each_line_stands_in_its_module():
    rows = [line.split("\t") for line in (TOP / "tests/equivalent_mutants.txt").read_text().splitlines()[1:]]
    assert [before for module, before, *_ in rows if before not in map(str.strip, (TOP / module).open())] == []


@pytest.mark.parametrize("name", ["test_a.py::test_b", "test_a.py::test_b[2^N - 6 (mapping)]", "test_a.py::TestC::test_b[one pass]"])
@pytest.mark.parametrize("why", ["", " - assert [1] == [2]"])
def test_a_test_that_failed_is_named_whole(name, why):
    assert witnesses.FAILED.search(f"1 failed\nFAILED tests/e2e/{name}{why}\n")[1] == f"tests/e2e/{name}"
