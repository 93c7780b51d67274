#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Tests the tests: puts one fault at a time into a module, and sees whether a test fails.

    mutate.py --each 30 --seed 1           30 faults in each module that a unit test loads
    mutate.py --each 5 yapp/wire/crc.lua   in one
    mutate.py --each 5 --other             in each of the others: those that call Wireshark's API, extcap/ and tools/src

A fault is another operator, another constant, a condition the other way round or a line left out; what does not compile is
none.  In a copy of the tree, until one fails, run the unit tests that load the module, those that name it first, in Lua 5.4,
then in 5.2; then those that SUITES names for the module, or for its folder if no unit test loads it.  For a line of tools/src
the tests run that reach it (tests/reach.py), the quickest first.  A mutant that no test fails on is shown with its line before
and after; one that cannot be told from the module stands in tests/equivalent_mutants.txt with the reason.
"""
import argparse
import collections
import concurrent.futures
import json
import math
import os
import pathlib
import pwd
import queue
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time

import reach
import witnesses

ROOT = pathlib.Path(__file__).resolve().parents[1]
TESTS = sorted(path.relative_to(ROOT) for path in ROOT.glob("tests/unit/test_*.lua"))
OTHERS = {"+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "~=",
          "~=": "==", "and": "or", "or": "and", "not": "", "true": "false", "false": "true"}
TOKEN = re.compile(r"""--\[(=*)\[.*?\]\1\]|--[^\n]*|\[(=*)\[.*?\]\2\]|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|0[xX][\da-fA-F]+|"""
                   r"""\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|\.\.\.?|[=~<>]=|\S""", re.S)
# In Python: the same without what is Lua's.
PYTHON_OTHERS = {"+": "-", "-": "+", "*": "/", "%": "*", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==",
                 "and": "or", "or": "and", "not": "", "True": "False", "False": "True"}
PYTHON_TOKEN = re.compile(r'''#[^\n]*|[rbf]*"""[\s\S]*?"""|[rbf]*"(?:\\.|[^"\\\n])*"|[rbf]*'(?:\\.|[^'\\\n])*'|0[xX][\da-fA-F]+|'''
                          r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|->|\*\*|//|[=!<>]=|[-+*/]=|\S")
PYTHON_NO_STATEMENT = re.compile(r"\s*(?:$|#|def\b|class\b|else\b|try\b|except\b|finally\b|with\b|for\b|while\b|if\b|elif\b|import\b|from\b|@|"
                                 r'"""|[\])}{]|.*[,({\[:]\s*$)')
# The quickest tests of what no unit test loads: the longest beginning counts.
SUITES = {
    "yapp.lua": ["tests/e2e/test_preferences.py", "tests/e2e/test_captures.py", "tests/e2e/test_install.py", "tests/e2e/test_buses.py",
                 "tests/e2e/test_unknown_ids.py", "tests/e2e/test_locale.py"],
    "yapp/": ["tests/e2e/test_captures.py", "tests/e2e/test_experts.py", "tests/e2e/test_statistics.py"],
    "yapp/show/": ["tests/e2e/test_captures.py", "tests/e2e/test_experts.py", "tests/e2e/test_flight_fields.py", "tests/e2e/test_messages.py", "tests/e2e/test_preferences.py",
                   "tests/e2e/test_same_everywhere.py"],
    "yapp/show/fields.lua": ["tests/e2e/test_experts.py", "tests/e2e/test_captures.py"],
    "yapp/show/packet.lua": ["tests/e2e/test_captures.py", "tests/e2e/test_streams.py"],
    "yapp/host/can.lua": ["tests/e2e/test_captures.py", "tests/e2e/test_experts.py", "tests/e2e/test_can_soak.py", "tests/e2e/test_unknown_ids.py"],
    "yapp/host/buses.lua": ["tests/e2e/test_buses.py", "tests/e2e/test_live.py"],
    "yapp/host/serial.lua": ["tests/e2e/test_captures.py", "tests/e2e/test_streams.py", "tests/e2e/test_stream_cases.py"],
    "yapp/host/": ["tests/e2e/test_captures.py", "tests/e2e/test_buses.py", "tests/e2e/test_streams.py"],
    "yapp/serial/": ["tests/e2e/test_captures.py", "tests/e2e/test_streams.py"],
    "yapp/file/": ["tests/e2e/test_candump.py", "tests/e2e/test_dump.py", "tests/e2e/test_files.py"],
    "yapp/stat/": ["tests/e2e/test_statistics.py", "tests/e2e/test_gate.py"],
    "extcap/": ["tests/e2e/test_live.py"],
}
QUICK = 12  # tests that run in one process before the others
LUAS = ("lua5.4", "lua5.2")
ENDS = {"if": "then", "elseif": "then", "while": "do"}
# A line that is no statement of its own, or without which a local variable is nil: the first test sees that.  A field that is
# nil or false in a constructor documents itself: without it nothing changes.
NO_STATEMENT = re.compile(r"\s*(?:$|--|\"|local\b|function\b|else|end\b|until\b|repeat\b|for\b|while\b|\w+ = (?:nil|false),|[\])}{]|"
                          r".*[,({]\s*$)")
BYTES = re.compile(r"local [\w, ]+ = (?:\w+:byte\(|byte\([\w.]+, )[^(),]+, (?:\w+ \+ )?\d+\)$")
LEAST = re.compile(r"if (?:not \S+ or )?(\S+) [<>] (\S+) then \2 = \1 end$")
MEMORY = 2 * 2**30
# Mutants remove, rename and write files of any name: never as root.
NOBODY = pwd.getpwnam("nobody")
USER = {"user": NOBODY.pw_uid, "group": NOBODY.pw_gid, "extra_groups": []} if os.geteuid() == 0 else {}


def lua(*arguments, folder=ROOT):
    return subprocess.run(["lua5.4", *map(str, arguments)], cwd=folder, capture_output=True, text=True, check=False)


def loaded_modules(loads):
    """The modules of the plugin that a unit test loads."""
    paths = [path.relative_to(ROOT) for path in [ROOT / "yapp.lua", *sorted(ROOT.glob("yapp/**/*.lua"))]]
    return [path for path in paths if any(path in one for one in loads.values())]


def other_modules(loads):
    """All others: those that call Wireshark's API, the live ports, the Python package."""
    paths = [ROOT / "yapp.lua", *sorted(ROOT.glob("yapp/**/*.lua")), *sorted(ROOT.glob("extcap/*.py")), *sorted(ROOT.glob("tools/src/**/*.py"))]
    loaded = loaded_modules(loads)
    return [path.relative_to(ROOT) for path in paths if path.relative_to(ROOT) not in loaded]


def loaded_by(test):
    """The modules that a file of unit tests loads."""
    code = ("package.path = './?.lua;./tests/unit/?.lua;' .. package.path .. ';/usr/share/lua/5.4/?.lua' "
            f"dofile('{test}') for name in pairs(package.loaded) do print(name) end")
    names = lua("-e", code).stdout.split()
    names += re.findall(r'require\(?"(yapp[\w.]+)"', (ROOT / test).read_text())  # also what a test loads as it runs
    names += re.findall(r'"(yapp[\w/]*)\.lua"', (ROOT / test).read_text())
    return {pathlib.Path(name.replace(".", "/") + ".lua") for name in names}


def other_number(word):
    """A number of Lua as another one: of 1e9 one more would be lost in the rounding of what it divides."""
    if re.search(r"^\d+[.]?\d*[eE]", word):
        return str(float(word) * 2)
    return str((float(word) if "." in word else int(word, 0)) + 1)


def is_package(path):
    return path.parts[:2] == ("tools", "src")


def is_python(path):
    return path.suffix == ".py"


def python_mutants(text):
    texts = []  # what stands in one is no statement
    for token in PYTHON_TOKEN.finditer(text):
        word = token[0]
        if text.endswith(("strict=", "frozen="), 0, token.start()):
            continue  # they guard against what no code does
        if word in PYTHON_OTHERS:
            yield (*token.span(), PYTHON_OTHERS[word])
        elif word[0].isdigit():
            yield (*token.span(), other_number(word))
        elif word.endswith('"""'):
            texts.append(token.span())
    for line in re.finditer(r"[^\n]+", text):
        is_text = any(first < line.end() - 1 and line.start() < last for first, last in texts)
        if not PYTHON_NO_STATEMENT.match(line[0]) and not is_text:
            yield (*line.span(), re.match(r"\s*", line[0])[0] + "pass")


def compiles(path, mutant):
    if not is_python(path):
        return subprocess.run(["luac5.4", "-p", "-"], input=mutant, text=True, capture_output=True, check=False).returncode == 0
    try:
        compile(mutant, path, "exec")
    except (SyntaxError, ValueError):
        return False
    return True


def mutants(path, text):
    """All mutants of a module: (first character, the one behind the last, what stands there instead)."""
    if is_python(path):
        yield from python_mutants(text)
        return
    tokens = [one for one in TOKEN.finditer(text) if not one[0].startswith("--")]
    for at, token in enumerate(tokens):
        word = token[0]
        line = line_at(text, token.start())
        if word == "<" and "table.sort(" in line:
            continue  # equals may change places in any case
        if word[0].isdigit() and BYTES.match(line) and text.startswith(")\n", token.end()):
            continue  # a byte more, which no variable takes
        if word in "<>" and LEAST.match(line):
            continue  # of two equals either is the least
        if word == "+" and text.startswith("0.0", token.end() + 1):
            continue  # nothing is added to make a float: taking it away makes one, too
        if word in OTHERS:
            yield (*token.span(), OTHERS[word])
        elif word[0].isdigit():
            yield (*token.span(), other_number(word))
        elif word in ENDS:
            end = next((one for one in tokens[at:] if one[0] == ENDS[word]), None)
            if end:
                yield token.end(), end.start(), f" not ({text[token.end():end.start()].strip()}) "
    texts = [token.span() for token in tokens if token[0].startswith("[[")]  # what stands in one is no statement
    for line in re.finditer(r"[^\n]+", text):
        if not NO_STATEMENT.match(line[0]) and not any(first < line.start() < last for first, last in texts):
            yield (*line.span(), "")


def line_at(text, place):
    return text[text.rfind("\n", 0, place) + 1:].split("\n")[0].strip()


def sample(path, each, seed, equivalent):
    """So many mutants of a module that compile and are not listed: [(number of the line, before, after, text)]."""
    text, chosen = (ROOT / path).read_text(), []
    every = list(mutants(path, text))
    random.Random(f"{seed} {path}").shuffle(every)
    for start, end, new in every:
        if len(chosen) == each:
            break
        mutant = text[:start] + new + text[end:]
        lines = line_at(text, start), line_at(mutant, start) or "(left out)"
        if (str(path), *lines) not in equivalent and compiles(path, mutant):
            chosen.append((text.count("\n", 0, start) + 1, *lines, mutant))
    return chosen


def passes(folder, test, most, programs=LUAS):
    """Whether a file of tests passes in a copy of the tree, each Lua in so many CPU seconds."""
    limits = ["prlimit", f"--cpu={most}", f"--as={MEMORY}"]
    for program in programs:
        run = subprocess.run([*limits, program, "tests/unit/run.lua", test], cwd=folder, stdout=subprocess.DEVNULL,
                             stderr=subprocess.DEVNULL, env={**os.environ, "YAPP_FIRST_FAILURE": "1"},
                             check=False, timeout=60 * most, **USER)
        if run.returncode != 0:
            return False
    return True


def suite_of(path):
    return SUITES[max((begin for begin in SUITES if str(path).startswith(begin)), key=len)]


known = collections.defaultdict(witnesses.Witnesses)  # by module


def environment_of(folder):
    return {**os.environ, "YAPP_PLUGIN_ROOT": str(folder), "PYTHONPATH": str(folder / "tools/src"), "YAPP_TIMEOUT": "60"}


def failed_test(folder, path, python, suite, most=600):
    """The first test of a suite that fails in a copy of the tree: a mutant may make it wait without end, and take all memory."""
    command = ["prlimit", f"--as={2 * MEMORY}", python if is_package(path) else "/usr/bin/python3", "-m", "pytest"]
    return witnesses.failed_test(suite, command, cwd=folder, timeout=most, env=environment_of(folder), **USER)


def passes_suites(folder, path, python, suites):
    """Whether suites pass in a copy of the tree: first the tests that failed before, unless suites are chosen for the line."""
    def run(suite):
        return failed_test(folder, path, python, suite)

    return not (any(map(run, suites)) if is_package(path) else known[path].failed_test(suites, run))


def survives(folder, path, mutant, tests, seconds_of, python, suites):
    """Whether all tests pass with a mutant in a copy of the tree: the unit tests in the CPU seconds that they need, and more,
    then the suites."""
    whole = (folder / path).read_text()
    (folder / path).write_text(mutant)
    try:
        return (all(passes(folder, test, math.ceil(2 + 5 * seconds_of(test)), [program]) for program in LUAS for test in tests) and
                passes_suites(folder, path, python, suites))
    except subprocess.TimeoutExpired:
        return False
    finally:
        (folder / path).write_text(whole)


def reached_lines(folder, options):
    """Which tests reach which lines of tools/src."""
    if options.reach and options.reach.exists():
        return json.loads(options.reach.read_text())
    done = subprocess.run([options.python, "tests/reach.py"], cwd=folder, stdout=subprocess.PIPE, text=True, check=True,
                          env=environment_of(folder), **USER)
    if options.reach:
        options.reach.write_text(done.stdout)
    return json.loads(done.stdout)


def copies(count, folder):
    """Copies of what the tests need."""
    found = queue.Queue()
    for number in range(count):
        shutil.copytree(ROOT, folder / str(number), ignore=shutil.ignore_patterns(".git", "dist", "node_modules", "__pycache__"))
        subprocess.run(["chmod", "-R", "a+rX", folder], check=True)
        found.put(folder / str(number))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--each", type=int, default=30, help="mutants of a module")
    parser.add_argument("--seed", default="1")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--least", type=float, default=95, help="per cent that have to be killed")
    parser.add_argument("--other", action="store_true", help="those that no unit test loads")
    parser.add_argument("--unit", action="store_true", help="by the unit tests alone")
    parser.add_argument("--python", default=sys.executable, help="that has what tests/tools needs")
    parser.add_argument("--reach", type=pathlib.Path, help="what tests/reach.py printed; measured if it is not given")
    parser.add_argument("modules", nargs="*", type=pathlib.Path, help="all that need no Wireshark by default")
    options = parser.parse_args()
    needs_python = options.other or any(map(is_package, options.modules))
    if needs_python and USER and subprocess.run([options.python, "-V"], capture_output=True, check=False, **USER).returncode:
        parser.error(f"{options.python} is not for the user nobody")
    seconds, loads = {}, {test: loaded_by(test) for test in TESTS}
    equivalent = {tuple(line.split("\t")[:3]) for line in (ROOT / "tests/equivalent_mutants.txt").read_text().splitlines()}

    def tests_of(path):
        """Those that load the module: first those that name it, the short ones first."""
        name, texts = ".".join(path.with_suffix("").parts), {test: (ROOT / test).read_text() for test in TESTS if path in loads[test]}
        return sorted(texts, key=lambda test: (f'"{name}"' not in texts[test], len(texts[test])))

    score, start = {}, time.monotonic()
    with tempfile.TemporaryDirectory(prefix="yapp-mutants-") as folder, \
            concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
        free = copies(options.jobs + 1, pathlib.Path(folder))
        whole, measuring = free.get(), threading.Lock()
        modules = options.modules or (other_modules(loads) if options.other else loaded_modules(loads))
        reached = reached_lines(whole, options) if any(map(is_package, modules)) else None

        def seconds_of(test):
            """The CPU seconds that a test takes in a copy without a mutant, where a file may be missing; measured once."""
            with measuring:
                if test not in seconds:
                    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
                    # What takes long may fail once.
                    assert passes(whole, test, 600, LUAS[:1]) or passes(whole, test, 600), f"{test} fails without a mutant"
                    seconds[test] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
                return seconds[test]

        def suites(path, line):
            if is_package(path):
                tests = reach.tests_of(reached, path, (ROOT / path).read_text(), line)
                return [tests[:QUICK], tests[QUICK:]] if tests[QUICK:] else [tests] if tests else []
            has_own = str(path) in SUITES or not tests_of(path)
            return [[file] for file in suite_of(path)] if has_own and not options.unit else []

        def judge(path, line, before, after, mutant):
            copy = free.get()
            try:
                return line, before, after, survives(copy, path, mutant, tests_of(path), seconds_of, options.python, suites(path, line))
            finally:
                free.put(copy)

        running = {path: [pool.submit(judge, path, *one) for one in sample(path, options.each, options.seed, equivalent)]
                   for path in modules}
        for path, of_path in running.items():
            alive = 0
            for one in of_path:
                line, before, after, survived = one.result()
                alive += survived
                if survived:
                    print(f"{path}:{line}:\n  - {before}\n  + {after}", flush=True)
            score[path] = len(of_path) - alive, len(of_path)
            print(f"{path}: {score[path][0]} of {score[path][1]} killed", flush=True)
        for path, one in known.items():  # a test that fails without a mutant kills none
            failed = one.known and failed_test(whole, path, options.python, one.known)
            assert not failed, f"{path}: {failed} fails without a mutant"
    killed, every = map(sum, zip(*score.values()))
    print(f"mutate: seed {options.seed}, {killed} of {every} killed, {100 * killed / every:.1f} %, "
          f"{time.monotonic() - start:.0f} s")
    return 0 if killed >= every * options.least / 100 else 1


if __name__ == "__main__":
    sys.exit(main())
