# SPDX-License-Identifier: GPL-2.0-or-later
"""What tests the tests: the list of mutants that no test can tell from the module names mutants that are made; which test failed."""
import pathlib
import sys

import pytest

TOP = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "tests"))
import mutate  # noqa: E402
import witnesses  # noqa: E402


def lines_of_mutants(module):
    """The mutants of a module as the list has them: (line before, line after)."""
    text = (TOP / module).read_text()
    for start, end, new in mutate.mutants(pathlib.Path(module), text):
        yield mutate.line_at(text, start), mutate.line_at(text[:start] + new + text[end:], start) or "(left out)"


def mutated(line, module="one.lua"):
    """The mutants of a module with this line alone."""
    return {line[:start] + new + line[end:] for start, end, new in mutate.mutants(pathlib.Path(module), line)}


def test_each_row_is_a_mutant_of_its_module():
    rows = [line.split("\t") for line in (TOP / "tests/equivalent_mutants.txt").read_text().splitlines()[1:]]
    made = {module: set(lines_of_mutants(module)) for module in {row[0] for row in rows}}
    assert rows
    assert [row for row in rows if len(row) != 4 or (row[1], row[2]) not in made[row[0]]] == []


@pytest.mark.parametrize("line, is_made", [
    ("if a.b > most then most = a.b end", False), ("if not most or a.b > most then most = a.b end", False),
    ("if not most or a.b > most then found = a.b end", True),
])
def test_of_two_equals_either_is_the_least(line, is_made):
    assert (line.replace(">", ">=") in mutated(line)) is is_made


def test_a_guard_of_python_is_no_behaviour():
    assert mutated("a = zip(b, c, strict=True)", "one.py") == {"pass"}
    assert "a = f(b=False)" in mutated("a = f(b=True)", "one.py")


def test_nothing_is_added_to_make_a_float():
    assert "a = b - 0.0" not in mutated("a = b + 0.0") and "a = b - 0.5" in mutated("a = b + 0.5")


@pytest.mark.parametrize("name", ["test_a.py::test_b", "test_a.py::test_b[2^N - 6 (mapping)]", "test_a.py::TestC::test_b[one pass]"])
@pytest.mark.parametrize("why", ["", " - assert [1] == [2]"])
def test_a_test_that_failed_is_named_whole(name, why):
    assert witnesses.FAILED.search(f"1 failed\nFAILED tests/e2e/{name}{why}\n")[1] == f"tests/e2e/{name}"
