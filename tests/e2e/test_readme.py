# SPDX-License-Identifier: GPL-2.0-or-later
"""What README.md, CONTRIBUTING.md and pages of docs say: their commands in a real shell, their filters, names of files and functions."""
import os
import re
import shutil
import subprocess
import sys

import pytest

import flight as flight_capture
import flights
import levels
import model
import tshark

pytestmark = levels.together("readme")
README = (tshark.ROOT / "README.md").read_text()
STATISTICS = (tshark.ROOT / "docs/statistics.md").read_text()
MAP = (tshark.ROOT / "CONTRIBUTING.md").read_text()
FLIGHT = flights.make(3)


def table(title, page=README):
    """The rows of the table under a heading: lists of cells, without the head."""
    rows = re.search(rf"\n## {title}\n(?:.*\n)*?((?:\|.*\n)+)", page)[1].splitlines()[2:]
    return [[cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows]


QUESTIONS = [row[1].strip("`").replace("docs/", "") for row in table("Questions and answers", STATISTICS)]
FAULT = (tshark.ROOT / "docs/fault.md").read_text()
# (exit code or nothing, command, what it prints)
EXAMPLES = re.findall(r"<!-- run( \d+)? -->\n    \$ (.*)\n((?:    .*\n)+)", README + FAULT)
SEVERAL = re.findall(r"^    (tshark -r run.* -o .*)", README, re.M)
# Other files have tests of a bench, of the profile, of what is installed, and of the other pages.
OTHERS = [line for page in ("README", *(f"docs/{name}" for name in "install controllers rules reading statistics samples profile".split()))
          for line in re.findall(r"^ {4,}((?:tshark|mergecap) .*)", (tshark.ROOT / f"{page}.md").read_text(), re.M)
          if not re.search("-i can0|-C YAPP|-G plugins", line)]


def shell(folder, command, *arguments):
    """Runs a line in bash, with a tshark in front that loads the plugin and takes some arguments more."""
    wrapper = folder / "bin/tshark"
    wrapper.parent.mkdir(exist_ok=True)
    quoted = " ".join(f"'{argument}'" for argument in [*tshark.load(), *arguments])
    wrapper.write_text(f'#!/bin/sh\nexec {shutil.which("tshark")} {quoted} "$@"\n')
    wrapper.chmod(0o755)
    environment = {**os.environ, "HOME": str(tshark.home()), "LC_ALL": "C.UTF-8", "TZ": "UTC",
                   "PATH": f"{wrapper.parent}:{os.environ['PATH']}"}
    environment.pop("XDG_CONFIG_HOME", None)
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True,
                          timeout=tshark.TIMEOUT, stdin=subprocess.DEVNULL, **tshark._user())
    assert "Lua" not in done.stderr, done.stderr
    return done


@pytest.fixture
def flight(folder):
    FLIGHT.write(folder / "flight.pcapng", "pcapng")
    return folder


@pytest.mark.parametrize("code, command, printed", EXAMPLES, ids=lambda text: text[:60])
def test_examples_print_what_they_say(folder, code, command, printed):
    for name in ("yapp.lua", "taurus_fields.lua", "yapp", "test_captures", "docs"):
        (folder / name).symlink_to(tshark.ROOT / name)
    done = shell(folder, command.replace(" -X lua_script:yapp.lua", ""))
    wanted = [line[4:].rstrip() for line in printed.splitlines()]
    assert [line.rstrip() for line in done.stdout.splitlines()] == wanted, f"run make regenerate, and read the difference {done.stderr}"
    assert done.returncode == int(code or 0)


def test_commands_without_a_sample(folder):
    """None is refused, and each prints or writes something; what it is, tests of its subject have."""
    for name in ("yapp.lua", "taurus_fields.lua", "yapp", "docs"):
        (folder / name).symlink_to(tshark.ROOT / name)
    for name in ("run", "first_bus", "second_bus"):
        shutil.copy(tshark.ROOT / "docs/flight.pcapng", folder / f"{name}.pcapng")
    shutil.copy(tshark.CAPTURES / "serial/document_uart_rtac.pcap", folder / "rtac.pcap")
    assert len(OTHERS) == 24
    for command in sorted(set(OTHERS), reverse=True):  # mergecap is the last, and overwrites run.pcapng
        done = shell(folder, command.replace(" -X lua_script:yapp.lua", ""))
        assert done.returncode in ((0, 20) if "yapp,check" in command else (0,)), (command, done.stderr)
        assert done.stdout or " -w " in command, command


@levels.without_tshark("of the page alone")
def test_all_examples_are_tried():
    commands = re.findall(r"^    (?:\$ )?((?:tshark|wireshark) .*)", FAULT, re.M)
    assert len(commands) == 6 and sum(command.startswith("wireshark") for command in commands) == 1
    assert len(EXAMPLES) == 1 + 5


@pytest.mark.parametrize("plan", flight_capture.PLANS, ids=lambda plan: plan.name)
@levels.without_tshark("compares two files")
def test_a_flight_is_made_by_its_script(plan):
    assert plan.target.read_bytes() == flight_capture.flight(plan)


def test_the_questions_are_answered(flight):
    """In one run.  test_statistics.py has what they print."""
    found = [re.fullmatch(r"tshark -q -r flight\.pcapng -z (yapp,\S+)", command) for command in QUESTIONS]
    asked = [match[1] for match in found if match]
    done = shell(flight, " -z ".join(["tshark -q -r flight.pcapng", *asked]), *FLIGHT.arguments("pcapng"))
    assert done.returncode == 20, done.stderr  # the flight has faults, which check does not let pass
    assert all((flight / f"tables/{message.name}.csv").exists() for message in model.MESSAGES.values())
    assert len(re.findall(r"(?m)^1700\d+\.\d{9},", done.stdout)) == len(FLIGHT.rows("pcapng")["motor"])
    assert set(re.findall(r"(?m)^YAPP (\w+): ", done.stdout)) == {what.split(",")[1] for what in asked}


@pytest.mark.parametrize("command", [command for command in QUESTIONS if "-q -r flight.pcapng -z yapp" not in command])
def test_a_question_is_answered(flight, command):
    done = shell(flight, command, *FLIGHT.arguments("pcapng"))
    assert done.returncode == 0, done.stderr
    if "yapp.message.fault" in command:
        frames = [frame.number for frame, _, _, message in FLIGHT.rows("pcapng")["motor"] if int.from_bytes(message.payload[18:22], "little")
                  for frame in message.frames]
        kept, times = (shell(flight, f"tshark -r {name} -T fields -e frame.time_epoch").stdout.split() for name in ("faults.pcapng", "flight.pcapng"))
        assert set(kept) >= {times[number - 1] for number in frames} and frames
    else:
        assert "-z expert" in command and "A fault was raised" in done.stdout and "A long gap before this message" in done.stdout


@levels.without_tshark("of the page alone")
def test_all_questions_are_tried():
    assert set(re.findall(r"-z yapp,(\w+)", " ".join(QUESTIONS))) == set(model.STATISTICS) - {"watch"} and len(SEVERAL) == 2


def test_several_controllers(flight):
    by_id, by_name = (shell(flight, command.replace("run.pcapng", "flight.pcapng")) for command in SEVERAL)
    assert by_id.returncode == by_name.returncode == 0
    assert "Motor Data 0x212 (vcan_2)" in by_id.stdout and "Health 0x201" in by_id.stdout
    assert "Motor Data right_fore" in by_name.stdout and "left_fore" not in by_name.stdout  # can1 alone has this ID


def assert_are_filters(filters):
    filters = ["frame.number == 1", *filters]
    done = tshark.run("-r", tshark.CAPTURES / "can/document_motor.pcap", "-Y", " || ".join(f"({one})" for one in filters))
    assert done.stdout.split()[0] == "1"


def test_its_filters_are_filters():
    cells = [row[1] for row in table("Filters")]
    filters = [text.replace("\\|", "|") for cell in cells for text in re.findall(r"`([^`]+)`", cell)]
    assert len(filters) >= 8
    assert_are_filters(filters)
    with pytest.raises(AssertionError):
        assert_are_filters([*filters, "taurus.no_such_field"])


def test_the_filters_of_the_help():
    text = (tshark.ROOT / "yapp/stat/windows.lua").read_text()
    filters = [part for line in re.findall(r"^.{32}((?:yapp|taurus)\..*)$", text, re.M) for part in re.split(r", or ", line)]
    assert len(filters) >= 9
    assert_are_filters(filters)


# What they name ----------------------------------------------------------------------------------------------------

@levels.without_tshark("of the page alone")
def test_the_map_names_what_there_is():
    """Files, their names and targets that CONTRIBUTING.md names are there."""
    for name, path in re.findall(r"`(\w+)` in `([\w/]+(?:\.\w+)?)`", MAP):
        files = [tshark.ROOT / f"yapp/{path}.lua", tshark.ROOT / path, *tshark.ROOT.glob(f"tests/*/{path}")]
        assert any(re.search(rf"\b{name}\b", one.read_text()) for one in files if one.is_file()), f"{path}: {name}"
    paths, targets = re.findall(r"`((?:tests|tools|docs|test_captures)/[\w./]+)`", MAP), re.findall(r"\bmake ([a-z-]+)\b", MAP)
    assert len(paths) > 5 and len(targets) > 5
    for path in paths:
        assert (tshark.ROOT / path).exists(), path
    makefile = (tshark.ROOT / "Makefile").read_text()
    for target in targets:
        assert re.search(rf"^[\w .-]*\b{target}\b[\w .-]*:", makefile, re.M), target


def test_the_page_of_filters(folder):
    """docs/filters.md is what the plugin has."""
    page = folder / "filters.md"
    subprocess.run([sys.executable, tshark.ROOT / "tools/filters_page.py", page], check=True, timeout=tshark.TIMEOUT)
    assert page.read_text() == (tshark.ROOT / "docs/filters.md").read_text(), "run make regenerate"
