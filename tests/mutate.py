#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Tests the tests: puts one fault at a time into a module of the plugin, and prints the share that the tests see.

    mutate.py --each 20 --seed 7           20 faults in each module that a unit test loads
    mutate.py --each 20 yapp/wire/crc.lua   in one

A fault is another operator, another constant, a condition the other way round or a line left out.  The unit tests that load the
module run in a copy of the tree, in Lua 5.4 and 5.2, until one fails.  A fault that no test sees is printed with its line before and after:
a few of them change nothing.
"""
import argparse
import concurrent.futures
import os
import pathlib
import pwd
import queue
import random
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
TESTS = sorted(path.relative_to(ROOT) for path in ROOT.glob("tests/unit/test_*.lua"))
OTHERS = {"+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "~=",
          "~=": "==", "and": "or", "or": "and", "not": "", "true": "false", "false": "true"}
TOKEN = re.compile(r"""--\[(=*)\[.*?\]\1\]|--[^\n]*|\[(=*)\[.*?\]\2\]|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|0[xX][\da-fA-F]+|"""
                   r"""\d+(?:\.\d+)?(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|\.\.\.?|[=~<>]=|\S""", re.S)
ENDS = {"if": "then", "elseif": "then", "while": "do"}
# No statement of its own, or one without which a local variable is nil; a field that is nil or false documents itself.
NO_STATEMENT = re.compile(r"\s*(?:$|--|\"|local\b|function\b|else|end\b|until\b|repeat\b|for\b|while\b|\w+ = (?:nil|false),|[\])}{]|"
                          r".*[,({]\s*$)")
LUAS = ["lua5.4", "lua5.2"]
SECONDS, MEMORY = 15, 2**29  # of CPU, four times what the longest takes, and bytes: a fault may make a loop endless
# Mutants remove, rename and write files of any name: never as root.
NOBODY = pwd.getpwnam("nobody")
USER = {"user": NOBODY.pw_uid, "group": NOBODY.pw_gid, "extra_groups": []} if os.geteuid() == 0 else {}


def loaded_by(test):
    """The modules that a file of unit tests loads."""
    code = ("package.path = './?.lua;./tests/unit/?.lua;' .. package.path .. ';/usr/share/lua/5.4/?.lua' "
            f"dofile('{test}') for name in pairs(package.loaded) do print(name) end")
    text = (ROOT / test).read_text()
    names = subprocess.run(["lua5.4", "-e", code], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    names += re.findall(r'require\(?"(yapp[\w.]+)"', text) + re.findall(r'"(yapp[\w/]*)\.lua"', text)
    return {pathlib.Path(name.replace(".", "/") + ".lua") for name in names}


def line_at(text, place):
    return text[text.rfind("\n", 0, place) + 1:].split("\n")[0].strip()


def mutants(text):
    """All faults of a module: (first character, the one behind the last, what stands there instead)."""
    tokens = [one for one in TOKEN.finditer(text) if not one[0].startswith("--")]
    for at, token in enumerate(tokens):
        word = token[0]
        if word in OTHERS:
            yield (*token.span(), OTHERS[word])
        elif word[0].isdigit():
            yield (*token.span(), str((float(word) if re.search(r"[.eE]", word) and word[:2] != "0x" else int(word, 0)) + 1))
        elif word in ENDS:
            end = next((one for one in tokens[at:] if one[0] == ENDS[word]), None)
            if end:
                yield token.end(), end.start(), f" not ({text[token.end():end.start()].strip()}) "
    texts = [token.span() for token in tokens if token[0].startswith("[[")]  # what stands in one is no statement
    for line in re.finditer(r"[^\n]+", text):
        if not NO_STATEMENT.match(line[0]) and not any(first < line.start() < last for first, last in texts):
            yield (*line.span(), "")


def sample(path, each, seed):
    """So many mutants of a module that compile: [(number of the line, before, after, text)]."""
    text, chosen = (ROOT / path).read_text(), []
    every = list(mutants(text))
    random.Random(f"{seed} {path}").shuffle(every)
    for start, end, new in every:
        mutant = text[:start] + new + text[end:]
        done = subprocess.run(["luac5.4", "-p", "-"], input=mutant, text=True, capture_output=True, check=False)
        if done.returncode == 0 and len(chosen) < each:
            chosen.append((text.count("\n", 0, start) + 1, line_at(text, start), line_at(mutant, start) or "(left out)", mutant))
        if len(chosen) == each:
            break
    return chosen


def passes(folder, test, lua):
    """Whether a file of unit tests passes in a copy of the tree."""
    return subprocess.run(["prlimit", f"--cpu={SECONDS}", f"--as={MEMORY}", lua, "tests/unit/run.lua", test], cwd=folder, check=False,
                          stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, "YAPP_FIRST_FAILURE": "1"},
                          **USER).returncode == 0


def survives(folder, path, mutant, tests):
    """Whether all tests pass with a mutant in a copy of the tree."""
    whole = (folder / path).read_text()
    (folder / path).write_text(mutant)
    try:
        return all(passes(folder, test, lua) for lua in LUAS for test in tests)
    finally:
        (folder / path).write_text(whole)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--each", type=int, default=20, help="faults in a module")
    parser.add_argument("--seed", default="1")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--least", type=float, default=90, help="per cent of a module that tests have to see")
    parser.add_argument("modules", nargs="*", type=pathlib.Path, help="all that a unit test loads by default")
    options = parser.parse_args()
    loads, weak, seen, every = {test: loaded_by(test) for test in TESTS}, [], 0, 0
    paths = options.modules or [path.relative_to(ROOT) for path in [ROOT / "yapp.lua", *sorted(ROOT.glob("yapp/**/*.lua"))]]
    with tempfile.TemporaryDirectory(prefix="yapp-mutants-") as name, concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
        free = queue.Queue()
        for number in range(options.jobs):
            copy = pathlib.Path(name) / str(number)
            shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", "dist", "node_modules", "__pycache__"))
            free.put(copy)
        subprocess.run(["chmod", "-R", "a+rX", name], check=True)
        for path in paths:
            word = ".".join(path.with_suffix("").parts)
            texts = {test: (ROOT / test).read_text() for test in TESTS if path in loads[test]}
            tests = sorted(texts, key=lambda test: (f'"{word}"' not in texts[test], len(texts[test])))
            if not tests:
                print(f"{path}: no unit test loads it")
                continue

            def judge(row, path=path, tests=tests):
                copy = free.get()
                try:
                    return survives(copy, path, row[3], tests)
                finally:
                    free.put(copy)

            rows = sample(path, options.each, options.seed)
            alive = [row for row, is_alive in zip(rows, pool.map(judge, rows)) if is_alive]
            for line, before, after, _ in alive:
                print(f"{path}:{line}:\n  - {before}\n  + {after}")
            print(f"{path}: {len(rows) - len(alive)} of {len(rows)} seen", flush=True)
            seen, every = seen + len(rows) - len(alive), every + len(rows)
            if len(alive) * 100 > len(rows) * (100 - options.least):
                weak.append(str(path))
        assert all(passes(free.queue[0], test, lua) for lua in LUAS for test in TESTS), "the unit tests fail without a fault"
    print(f"mutate: seed {options.seed}, {seen} of {every} seen, {100 * seen / every:.1f} %; below {options.least:g} %: {', '.join(weak) or 'none'}")
    return 1 if weak else 0


if __name__ == "__main__":
    sys.exit(main())
