# SPDX-License-Identifier: GPL-2.0-or-later
"""A function of the tests that only compares, assert_..., check_... or compare, is proved able to fail: a test sees it fail."""
import ast
import pathlib

TESTS = pathlib.Path(__file__).resolve().parents[1]
COMPARES = ("assert_", "check_", "compare")


def name_of(call):
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def is_raises(node):
    """Whether a statement is `with pytest.raises(...)`."""
    return isinstance(node, ast.With) and any(isinstance(item.context_expr, ast.Call) and name_of(item.context_expr) == "raises"
                                              for item in node.items)


def is_comparison(node):
    """Whether a statement defines a function that compares and returns nothing."""
    return isinstance(node, ast.FunctionDef) and node.name.startswith(COMPARES) and \
        not any(isinstance(one, ast.Return) and one.value for one in ast.walk(node))


def test_each_is_seen_to_fail():
    defined, proved = {}, set()
    for path in sorted(TESTS.rglob("*.py")):
        tree = ast.parse(path.read_text())
        defined.update({node.name: path.relative_to(TESTS).as_posix() for node in ast.walk(tree) if is_comparison(node)})
        for node in filter(is_raises, ast.walk(tree)):
            proved |= {name_of(call) for one in node.body for call in ast.walk(one) if isinstance(call, ast.Call)}
    assert len(defined) > 10
    assert {name: path for name, path in defined.items() if name not in proved} == {}
