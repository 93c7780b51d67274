# SPDX-License-Identifier: GPL-2.0-or-later
"""Which tests of tests/tools run which lines of the Python package: a fault in a line needs no others.

    reach.py [OPTION OF PYTEST ...]    in the environment of the tests

runs them once with coverage, in processes that they start too, and prints
{"seconds": {test: seconds}, "lines": {module: {line: [test, ...]}}} as JSON.  A test that fails is left out.
"""
import ast
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

MAX_SECONDS = 60  # of the tests that judge one mutant, the quickest first
RC = "[run]\nparallel = true\ndata_file = {folder}/data\nsource = {source}\ncontext = ${{PYTEST_CURRENT_TEST-}}\ndisable_warnings = no-data-collected\n"
START = "import coverage\ncoverage.process_startup()\n"
PLUGIN = '''import coverage, json, os, pytest

@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    coverage.Coverage.current().switch_context(item.nodeid)
    yield
    coverage.Coverage.current().switch_context("")

seconds = {}

def pytest_runtest_logreport(report):
    known = seconds.get(report.nodeid, 0)
    seconds[report.nodeid] = None if known is None or report.outcome != "passed" else known + report.duration

def pytest_sessionfinish():
    if "PYTEST_XDIST_WORKER" not in os.environ:
        with open(os.environ["YAPP_SECONDS"], "w") as file:
            json.dump({test: time for test, time in seconds.items() if time is not None}, file)
'''


def measure(top, options):
    """What the program prints, of the tests of this tree."""
    import coverage

    with tempfile.TemporaryDirectory() as name:
        folder, source = pathlib.Path(name), top / "tools/src"
        (folder / "rc").write_text(RC.format(folder=folder, source=source))
        (folder / "sitecustomize.py").write_text(START)
        (folder / "reach_plugin.py").write_text(PLUGIN)
        paths = [str(folder), str(source)]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COVERAGE_PROCESS_START": str(folder / "rc"),
                       "YAPP_SECONDS": str(folder / "seconds")}
        subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "reach_plugin", *options, "tests/tools"], cwd=top,
                       env=environment, stdout=sys.stderr, check=False)
        seconds = json.loads((folder / "seconds").read_text())
        data = coverage.CoverageData(basename=str(folder / "all"))
        for path in folder.glob("data.*"):
            one = coverage.CoverageData(basename=str(path))
            one.read()
            data.update(one)
        lines = {}
        for path in data.measured_files():
            of_path = lines.setdefault(str(pathlib.Path(path).relative_to(top)), {})
            for line, contexts in data.contexts_by_lineno(path).items():
                tests = {re.sub(r" \((setup|call|teardown)\)$", "", one) for one in contexts} & seconds.keys()
                of_path[line] = sorted(tests)
    return {"seconds": seconds, "lines": lines}


def statement_at(tree, line):
    """The lines of the innermost statement with this line; None if it runs as the module is loaded."""
    inside, found = False, None

    def visit(node, in_function):
        nonlocal inside, found
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt) and child.lineno <= line <= child.end_lineno:
                inside, found = in_function, child
                visit(child, in_function or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef)))
            elif not isinstance(child, ast.stmt):
                visit(child, in_function)

    visit(tree, False)
    if not inside:
        return None
    body = getattr(found, "body", None)  # of an if, a loop: its head alone
    return range(found.lineno, (max(line, body[0].lineno - 1) if body else found.end_lineno) + 1)


def tests_of(reach, path, text, line):
    """The tests that run this line of a module, the quickest first."""
    of_path = {int(number): tests for number, tests in reach["lines"].get(str(path), {}).items()}
    lines = statement_at(ast.parse(text), line) or of_path
    tests = sorted({test for number in lines for test in of_path.get(number, [])}, key=lambda test: (reach["seconds"][test], test))
    total, chosen = 0, []
    for test in tests:
        total += reach["seconds"][test]
        if chosen and total > MAX_SECONDS:
            break
        chosen.append(test)
    return chosen


if __name__ == "__main__":
    json.dump(measure(pathlib.Path.cwd(), sys.argv[1:]), sys.stdout)
