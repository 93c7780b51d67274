# SPDX-License-Identifier: GPL-2.0-or-later
"""Where people write 0,5: what is shown, read, printed and judged is the same as where they write 0.5."""
import shutil
import subprocess

import levels
import pytest
import tshark

OWN = tshark.CAPTURES / "own_messages"
# Fractions in the tree and in the code that makes it; in times, catalogue, preferences, and texts that are read.
CAPTURES = ["can/health.pcap", "can/info_column.pcap", "can/events.pcap", "own_messages/scaled.pcap", "own_messages/cells.pcap",
            "candump/candump_log_nanoseconds.log", "candump/candump_screen_delta.txt", "candump/candump_screen_date.txt", "other/motor.asc"]


@pytest.fixture(scope="module")
def german():
    """The environment of a German.  Made here: few machines have such a locale."""
    folder = tshark.writable_folder()
    locale = folder / "de_DE.UTF-8"
    made = shutil.which("localedef") and subprocess.run(
        ["localedef", "-i", "de_DE", "-f", "UTF-8", str(locale)], capture_output=True, check=False).returncode == 0
    if not made:
        pytest.skip("no locale can be made")
    tshark.open_to_all(locale)
    yield {"LOCPATH": str(folder), "LC_ALL": "de_DE.UTF-8"}
    shutil.rmtree(folder)


def shown(name, environment, *arguments):
    """What tshark prints, what it complains of, and how it ends."""
    done = tshark.run("-2", "-r", tshark.CAPTURES / name, "-o", "yapp.late:1.5", *arguments, check=False,
                      env={"YAPP_MESSAGES": str(OWN / "messages.lua"), **environment})
    errors = [line for line in done.stderr.splitlines() if not line.startswith("Running as user")]
    return done.stdout, errors, done.returncode


@pytest.mark.parametrize("name", levels.few(CAPTURES, ["can/events.pcap", "own_messages/scaled.pcap", "candump/candump_screen_delta.txt"]))
def test_what_is_shown(german, name):
    """Times, the Info column, trees, expert items; and that a preference was understood."""
    arguments = ["-P", "-t", "e", "-O", "yapp,taurus"]
    wanted = shown(name, {}, *arguments)
    assert wanted[1:] == ([], 0) and "Taurus" in wanted[0]
    assert shown(name, german, *arguments) == wanted


@levels.without_tshark("of the C library")
def test_the_german_is_one(german):
    """The locale has an effect: where no plugin is, tshark itself writes a comma."""
    command = f"LC_ALL={german['LC_ALL']} LOCPATH={german['LOCPATH']} bash -c 'printf %.1f 1'"
    assert subprocess.run(command, shell=True, capture_output=True, text=True, check=True).stdout == "1,0"


STATISTICS = ["summary", "csv,-,motor", "check,json,motor.rate=0.5,motor.dc_voltage=-0.5..99.5", "summary,json", "faults",
              "events,json"]


def test_statistics(german):
    arguments = ["-q", *(word for statistic in STATISTICS for word in ("-z", f"yapp,{statistic}"))]
    wanted = shown("can/events.pcap", {}, *arguments)
    assert wanted[1] == [] and "." in wanted[0]
    assert shown("can/events.pcap", german, *arguments) == wanted
