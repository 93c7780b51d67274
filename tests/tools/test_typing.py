# SPDX-License-Identifier: GPL-2.0-or-later
"""mypy finds the slips of a user's script, and knows what comes back."""

import subprocess
import sys

SCRIPT = """\
import yapp_tables as yt

flight = yt.read("a.pcapng", options=["yapp.motor_ids:0x210"], messages=["motor"])
rows: int = flight["motor"].num_rows
for each in yt.read_many("x/*.pcapng", cache="c", sources={"0x210": "left"}):
    names: list[str] = list(each)
bad: list[str] = [result.capture for result in yt.convert("x/*", "out", to="parquet") if result.failure]
"""
SLIPS = {
    'yt.convert("x", "out", to="parket")': "expected \"Literal['parquet'",
    'yt.convert("x", "out", optionz=["x"])': 'did you mean "options"?',
    'yt.Config("x", "parket")': "expected \"Literal['parquet'",
    'yt.read("x", options=3)': "Sequence[str]",
    'next(yt.read_many("x", filters="y"))': 'did you mean "filter"?',
    'yt.report("x", overlays=True)': 'did you mean "overlay"?',
    'flight["motor"].num_row': 'maybe "num_rows"?',
    "flight.left": "has no attribute",
}


def test_slips_are_found_and_what_is_right_is_not(tmp_path):
    path = tmp_path / "script.py"
    path.write_text(SCRIPT + "\n".join(SLIPS) + "\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", tmp_path / "cache", path]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    errors = [line for line in done.stdout.splitlines() if ": error: " in line]
    first = SCRIPT.count("\n") + 1
    assert len(errors) == len(SLIPS), done.stdout
    for number, (slip, said) in enumerate(SLIPS.items(), first):
        (line,) = [each for each in errors if each.startswith(f"{path.name}:{number}:")]
        assert said in line, slip
