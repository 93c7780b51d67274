#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Tests the tests: gives one thing at a time that the plugin tells Wireshark a wrong value, by its name, and sees whether the
tests that claim to hold it turn red.

    plant.py                            everything
    plant.py --each 5 --seed 2          five of each kind
    plant.py severity                   one kind
    plant.py field taurus.motor.timestamp

The rows come from the plugin itself, as it registers them: tests/plant.lua lists them.  What stays green stands in tests/plants.txt
with the reason, or is a failure.
"""
import argparse
import os
import pathlib
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import tshark  # noqa: E402

CAPTURES = ["tests/e2e/test_captures.py", "-k", "fields_and_info or document_says"]
EXPERTS = ["tests/e2e/test_experts.py"]
# The tests that claim to hold a row of a kind, the quick ones first.
SUITES = {
    "field": [CAPTURES, ["tests/e2e/test_flight_fields.py"], ["tests/e2e/test_streams.py", "-k", "situation"],
              ["tests/e2e/test_buses.py", "tests/e2e/test_messages.py", "tests/e2e/test_captures.py", "tests/e2e/test_profile.py"]],
    "severity": [[*EXPERTS, "-k", "severity"]],
    "expert": [EXPERTS, ["tests/e2e/test_flight_fields.py", "tests/e2e/test_streams.py"], ["tests/e2e/test_can_soak.py"]],
    "preference": [["tests/e2e/test_preferences.py"], ["tests/e2e/test_profile.py"]],
    "statistic": [["tests/e2e/test_statistics.py", "tests/e2e/test_gate.py"]],
    "key": [["tests/e2e/test_statistics.py"], ["tests/e2e/test_gate.py", "tests/e2e/test_buses.py"]],
    "carrier": [CAPTURES, ["tests/e2e/test_streams.py", "-k", "situation or random"]],
}
STATISTICS = [argument for name in ("summary", "faults", "events", "check,fault=0", "compare") for argument in ("-z", f"yapp,{name},json")]


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
    folder = tshark.writable_folder()
    try:
        done = tshark.run("-X", f"lua_script:{copy(folder / 'plugin', None)}/yapp.lua", "-q", "-r", ROOT / "docs/flight.pcapng",
                          *STATISTICS, plugin=False, check=False)
    finally:
        shutil.rmtree(folder)
    found = [tuple(line.split("\t")[1:]) for line in done.stderr.splitlines() if line.startswith("plant\t")]
    assert {kind for kind, _ in found} >= set(SUITES), f"no rows of {set(SUITES) - {kind for kind, _ in found}}: {done.stderr[-500:]}"
    return [row for row in found if row[0] in SUITES]


def red(row, jobs):
    """The first suite that turns red with a row planted; None if none does."""
    with tempfile.TemporaryDirectory(prefix="yapp-plant-") as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        environment = {**os.environ, "YAPP_PLUGIN_ROOT": str(copy(folder / "plugin", row) if row[1] else ROOT)}
        for suite in SUITES[row[0]]:
            done = subprocess.run(["pytest-3", "-q", "-x", "-n", str(jobs), "--dist", "loadgroup", "-p", "no:cacheprovider", *suite],
                                  cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
            if re.search(r"^\d+ failed", done.stdout, re.MULTILINE):
                return suite[0]
            assert done.returncode == 0, f"{row}: {done.stdout[-1000:]}"
    return None


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--each", type=int, help="so many rows of each kind")
    parser.add_argument("--seed", default="1")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("kind", nargs="?", choices=SUITES)
    parser.add_argument("name", nargs="?")
    options = parser.parse_args()
    reasons = dict(line.rsplit("\t", 1) for line in (ROOT / "tests/plants.txt").read_text().splitlines() if not line.startswith("#"))
    chosen, start, green = [], time.monotonic(), []
    for kind in [options.kind] if options.kind else SUITES:
        some = [row for row in rows() if row[0] == kind and options.name in (None, row[1])]
        random.Random(f"{options.seed} {kind}").shuffle(some)
        chosen += some[:options.each]
    assert chosen, "no such row"
    for kind in {kind: True for kind, _ in chosen}:  # a suite that is red without a fault proves nothing
        suite = red((kind, None), options.jobs)
        assert not suite, f"{suite} fails without a fault"
    for row in chosen:
        suite = red(row, options.jobs)
        print(f"plant: {' '.join(row)}: {suite or 'NOTHING TURNS RED'}", flush=True)
        if not suite and "\t".join(row) not in reasons:
            green.append(row)
    print(f"plant: {len(chosen)} planted, {len(green)} that nothing notices, {time.monotonic() - start:.0f} s")
    return 1 if green else 0


if __name__ == "__main__":
    sys.exit(main())
