#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Tests the tests: gives one thing at a time that the plugin tells Wireshark a wrong value, by its name, and sees whether the
tests that claim to hold it turn red.

    plant.py                            everything
    plant.py --each 5 --seed 2          five of each kind
    plant.py severity                   one kind
    plant.py field --part 2/4           the second quarter of one
    plant.py field taurus.motor.timestamp

The rows come from the plugin itself, as it registers them: tests/plant.lua lists them.  A row runs the tests that turned red for
rows of its kind before, then the suites of its kind, until one turns red.  Prints the share that turned something red.
"""
import argparse
import multiprocessing.pool
import os
import pathlib
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.parse

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import tshark  # noqa: E402

LEAST = 90  # per cent
CAPTURES = ["tests/e2e/test_captures.py", "-k", "fields_and_info or document_says"]
ROUNDED = ["tests/e2e/test_captures.py", "-k", "rounded_values or is_like or each_flag"]
EXPERTS = ["tests/e2e/test_experts.py"]
# The tests that claim to hold a row of a kind, the quick ones first.
SUITES = {
    "field": [["tests/e2e/test_flight_fields.py"], ROUNDED, CAPTURES, ["tests/e2e/test_streams.py", "-k", "situation"],
              ["tests/e2e/test_experts.py", "-k", "one_item_of_each_kind or each_flag"],
              ["tests/e2e/test_buses.py", "tests/e2e/test_copies.py", "tests/e2e/test_messages.py", "tests/e2e/test_captures.py",
               "tests/e2e/test_profile.py"]],
    "severity": [[*EXPERTS, "-k", "severity"], ["tests/e2e/test_published.py"]],
    "expert": [EXPERTS, ["tests/e2e/test_flight_fields.py", "tests/e2e/test_copies.py", "tests/e2e/test_buses.py"], ["tests/e2e/test_can_soak.py"]],
    "preference": [["tests/e2e/test_published.py"], ["tests/e2e/test_preferences.py"]],
    "effect": [["tests/e2e/test_preferences.py"], ["tests/e2e/test_profile.py", "tests/e2e/test_messages.py", "tests/e2e/test_buses.py"],
               ["tests/e2e/test_streams.py"]],
    "statistic": [["tests/e2e/test_statistics.py", "tests/e2e/test_gate.py"]],
    "key": [["tests/e2e/test_statistics.py"], ["tests/e2e/test_gate.py", "tests/e2e/test_buses.py"]],
    "event": [["tests/e2e/test_statistics.py"], ["tests/e2e/test_gate.py", "tests/e2e/test_stream_cases.py"]],
    "column": [["tests/e2e/test_statistics.py"], ["tests/e2e/test_gate.py", "tests/e2e/test_readme.py"]],
    "csv": [["tests/e2e/test_statistics.py", "-k", "csv"]],
}
STATISTICS = [argument for name in ("summary", "faults", "events", "check,fault=0", "compare") for form in (",json", "")
              for argument in ("-z", f"yapp,{name}{form}")]
STATISTICS += [argument for message in ("command", "motor", "health") for argument in ("-z", f"yapp,csv,-,{message}")]


def copy(folder, row):
    """A copy of the plugin with a row planted; None lists the rows."""
    tshark.copy_plugin(folder, ROOT)
    plant = f'{{ "{row[0]}", "{row[1]}" }}' if row else "{}"
    script = shutil.copy(ROOT / "tests/plant.lua", folder)
    (folder / "yapp.lua").write_text(f'assert(loadfile("{script}"))({plant})\n' + (ROOT / "yapp.lua").read_text())
    subprocess.run(["chmod", "-R", "a+rX", folder], check=True)
    return folder


def rows():
    """All rows, as the plugin registers them: [(kind, name)]."""
    folder, said = tshark.writable_folder(), ""
    try:
        script = copy(folder / "plugin", None) / "yapp.lua"
        for capture in ("docs/flight.pcapng", "test_captures/can/events.pcap", "test_captures/serial/uart_shell.pcap"):
            said += tshark.run("-X", f"lua_script:{script}", "-q", "-r", ROOT / capture, *STATISTICS, plugin=False, check=False).stderr
    finally:
        shutil.rmtree(folder)
    found = list({tuple(line.split("\t")[1:]): True for line in said.splitlines() if line.startswith("plant\t")})
    assert {kind for kind, _ in found} >= set(SUITES), f"no rows of {set(SUITES) - {kind for kind, _ in found}}: {said[-500:]}"
    return [row for row in found if row[0] in SUITES]


# A name may have " - " between its brackets; behind it stands why it failed.
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+?::[^\[\s]+(?:\[.*?\](?= - |$))?)", re.MULTILINE)


def failed_test(suite, plugin):
    """The first test of a suite that fails, None if all pass; a suite that cannot be collected counts as one that fails."""
    done = subprocess.run(["pytest-3", "-q", "-x", "-rfE", "-p", "no:cacheprovider", *suite], capture_output=True, text=True, check=False,
                          cwd=ROOT, env={**os.environ, "YAPP_PLUGIN_ROOT": str(plugin)})
    failed = FAILED.search(done.stdout)
    assert failed or done.returncode in (0, 1, 2), f"{suite}: {done.stdout[-1000:]}{done.stderr[-500:]}"
    return failed[1] if failed else suite[0] if done.returncode else None


def suites_of(kind, name):
    """The suites of a row: a flight has the messages' fields, the captures those of YAPP."""
    first, *others = SUITES[kind]
    return [*others, first] if kind == "field" and name.startswith("yapp.") else [first, *others]


MAX_FIRST = 6  # tests that run first
known = {kind: [] for kind in SUITES}  # tests that turned red before, the latest first


def red(row, plugins):
    """The first test that turns red with a row planted, None if none does."""
    plugin, first = copy(plugins / "-".join(map(urllib.parse.quote_plus, row)), row), known[row[0]]
    try:
        for suite in [*([first[:MAX_FIRST]] if first else []), *suites_of(*row)]:
            test = failed_test(suite, plugin)
            if test:
                first[:] = [test, *(one for one in first if one != test)] if "::" in test else first
                return test
        return None
    finally:
        shutil.rmtree(plugin)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--each", type=int, help="so many rows of each kind")
    parser.add_argument("--seed", default="1")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--part", default="1/1", help="of the rows, as 2/4: the second of four")
    parser.add_argument("kind", nargs="?", choices=SUITES)
    parser.add_argument("name", nargs="?")
    options = parser.parse_args()
    part, parts = map(int, options.part.split("/"))
    chosen, start, green, were_red = [], time.monotonic(), [], set()
    every = rows()
    for kind in [options.kind] if options.kind else SUITES:
        some = [row for row in every if row[0] == kind and options.name in (None, row[1])]
        if options.each:
            random.Random(f"{options.seed} {kind}").shuffle(some)
        first, last = (len(some[:options.each]) * count // parts for count in (part - 1, part))
        chosen += some[first:last]  # neighbours: what turned red for one often does so for the next
    assert chosen, "no such row"
    with multiprocessing.pool.ThreadPool(options.jobs) as pool, tempfile.TemporaryDirectory(prefix="yapp-plant-") as name:
        plugins = pathlib.Path(name)
        plugins.chmod(0o755)
        for row, test in pool.imap_unordered(lambda row: (row, red(row, plugins)), chosen):
            print(f"plant: {' '.join(row)}: {test or 'NOTHING TURNS RED'}", flush=True)
            if test:
                were_red.add(test)
            else:
                green.append(row)
    # A test that is red without a fault proves nothing.
    failed = were_red and failed_test(sorted(were_red), ROOT)
    assert not failed, f"{failed} fails without a fault"
    share = 100 * (1 - len(green) / len(chosen))
    print(f"plant: {len(chosen)} planted, {share:.1f} % noticed, {time.monotonic() - start:.0f} s")
    return 1 if share < LEAST else 0


if __name__ == "__main__":
    sys.exit(main())
