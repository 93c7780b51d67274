# SPDX-License-Identifier: GPL-2.0-or-later
"""The jobs for other people's CI: ci/yapp-gate.sh, the action for GitHub and the job for GitLab, run as they would be."""
import os
import re
import shlex
import shutil
import subprocess
import xml.etree.ElementTree

import levels
import pytest
import test_gate
import tshark

RULES = "fault=0,crc=0,incomplete=0"
SYSTEM = f"{os.path.dirname(shutil.which('tshark'))}:/usr/bin:/bin:/usr/sbin:/sbin"
PROJECT = ["ci", "action.yml", *tshark.PLUGIN_FILES]


def run(command, folder, **variables):
    """Runs it with nothing of this machine's settings; returns the completed process."""
    environment = {"PATH": SYSTEM, "HOME": str(folder), "LC_ALL": "C.UTF-8", "TMPDIR": str(folder), **variables}
    return subprocess.run(list(map(str, command)), cwd=folder, env=environment, capture_output=True, text=True, check=False,
                          timeout=tshark.TIMEOUT, stdin=subprocess.DEVNULL)


@pytest.fixture
def project(folder):
    """The project as somebody else's job has it: a copy, which may be changed."""
    top = folder / "project"
    top.mkdir()
    for name in PROJECT:
        source = tshark.ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, top / name)
    return top


@pytest.fixture(scope="module")
def flights():
    """A folder with a flight without faults, the flight with one, and what is no capture."""
    folder = tshark.writable_folder()
    shutil.copy(tshark.ROOT / "docs/flight.pcapng", folder / "fault.pcapng")
    (folder / "text.pcapng").write_text("no capture\n")
    tshark.run("-r", tshark.ROOT / "docs/flight.pcapng", "-Y", "frame.time_relative < 5.05", "-w", folder / "clean.pcapng")
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def break_message(project):
    """One more message than there was, which is wrong."""
    path = project / "taurus_fields.lua"
    text, first = path.read_text(), "return {\n"
    assert text.count(first) == 1
    path.write_text(text.replace(first, first + '  { name = "broken", id = 0x333, size = 1 },\n'))


CASES = {"clean": ("clean.pcapng", None, 0), "fault": ("fault.pcapng", None, 20),
         "broken catalogue": ("clean.pcapng", break_message, 21)}

def gate(project, folder, *words):
    return run([project / "ci/yapp-gate.sh", *words], folder)


def arguments(capture, rules=RULES):
    return ["--rules", rules, "--sources", "", "--messages", "", "--junit", "report.xml", capture]


@pytest.mark.parametrize("capture, change, code", CASES.values(), ids=CASES)
def test_the_script(folder, project, flights, capture, change, code):
    if change:
        change(project)
    done = gate(project, folder, *arguments(flights / capture))
    assert done.returncode == code, done.stdout + done.stderr
    assert (folder / "report.xml").read_text().startswith("<?xml")
    assert not list(folder.glob("tmp.*"))  # its own folder is gone


@pytest.mark.parametrize("capture", levels.few(["nothing.pcapng", "text.pcapng", ".", ""], ["nothing.pcapng", "text.pcapng"]))
@levels.without_tshark("of the script alone: no capture is found, nothing runs")
def test_no_capture(folder, project, flights, capture):
    done = gate(project, folder, *arguments(capture and flights / capture))
    assert done.returncode not in (0, 20, 21) and done.stderr


def test_rules_in_a_file(folder, project, flights):
    """The job's folder is another one than the user's.  A hundred rules, as baseline learns them, are more than mawk's sprintf holds."""
    for rules, code in (("fault=0 # none\n" + "".join(f"motor.rate=8..{most}\n" for most in range(12, 112)), 0), ("motor.rate=..1\n", 20)):
        (folder / "my rules.txt").write_text(rules)
        done = gate(project, folder, "--rules", "my rules.txt", flights / "clean.pcapng")
        assert done.returncode == code, done.stdout + done.stderr


def test_sources_and_messages(folder, project, flights):
    """They reach the plugin, and nobody else's settings do."""
    (folder / ".config/wireshark").mkdir(parents=True)
    (folder / ".config/wireshark/preferences").write_text("yapp.sources: 0x210=motor:mine\n")
    done = gate(project, folder, "--sources", "can0/0x210=motor:left", "--rules", RULES, flights / "clean.pcapng")
    assert done.returncode == 0 and " left " in done.stdout and "mine" not in done.stdout
    (folder / "my messages.lua").write_text("return {")
    done = gate(project, folder, "--messages", "my messages.lua", "--rules", RULES, flights / "clean.pcapng")
    assert done.returncode == 21 and "messages.lua" in done.stderr


# Several captures --------------------------------------------------------------------------------------------------

WAIVERS = """# of the bench
fault* fault=0 can1/0x210 until=2099-01-31 the old motor
fault* reboot * until=2020-01-31 a supply
x* * * until=2099-01-31 a flight that is gone
"""


def test_several_captures(folder, project, flights):
    """Files and patterns; a suite each, a table, the worst code.  A damaged one is worse than one that could not be judged."""
    report, summary = folder / "out/report.xml", folder / "summary.md"
    done = gate(project, folder, "--rules", RULES, "--junit", report, "--summary", summary, flights / "clean.pcapng",
                f"{flights}/[f]*.pcapng")
    assert done.returncode == 20 and "FAILED  fault=0" in done.stdout, done.stdout + done.stderr
    assert f"{flights}/clean.pcapng: " not in done.stdout  # all is well there
    suites = xml.etree.ElementTree.parse(report).getroot()
    assert [(suite.get("name"), suite.get("failures")) for suite in suites] == \
        [(f"{flights}/clean.pcapng", "0"), (f"{flights}/fault.pcapng", "1")]
    assert all(int(suite.get("tests")) == len(suite) > 4 for suite in suites)
    table = summary.read_text()
    assert f"| rule | {flights}/clean.pcapng | {flights}/fault.pcapng |" in table
    assert "| `fault=0` | ok | FAILED can1 0x210 |" in table
    assert gate(project, folder, "--rules", RULES, "*.pcapng").returncode == 2  # no file matches
    both = gate(project, folder, "--rules", "note.count=1", flights / "clean.pcapng", flights / "text.pcapng")
    no_capture = 2 if tshark.version() < (4, 2) else 3
    assert both.returncode == no_capture and "NOT JUDGED" in both.stdout, both.stdout


def test_waivers(folder, project, flights):
    (folder / "waivers").write_text(WAIVERS)
    words = ["--waive", "waivers", "--junit", "report.xml", flights / "fault.pcapng"]
    done = gate(project, folder, "--rules", RULES, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    suite = xml.etree.ElementTree.parse(folder / "report.xml").getroot()
    assert (suite.get("failures"), suite.get("skipped")) == ("0", "1")
    assert suite.find(".//skipped").get("message") == "waived until 2099-01-31: the old motor: seen 1, frame 719"
    assert "waivers:4: unused: a flight that is gone" in done.stderr and "waivers:3: unused: a supply" in done.stderr
    done = gate(project, folder, "--rules", "fault=0,reboot=0", *words)
    assert done.returncode == 20 and "waivers:3: expired on 2020-01-31: a supply" in done.stderr
    (folder / "waivers").write_text("fault* fault=0 * 2099-01-31 why\n")
    done = gate(project, folder, *words)
    assert done.returncode == 2 and "waivers:1: a waiver is CAPTURE-PATTERN RULE SOURCE until=" in done.stderr


# What it installs ------------------------------------------------------------------------------------------------------

def test_preferences_and_decode_as(folder, project, flights):
    """-o, -d and --preferences reach tshark, and a hint that the script prints can be pasted into it."""
    other = folder / "other.pcapng"
    other.write_bytes(test_gate.pcapng(test_gate.flight(ident=0x310)))
    first = gate(project, folder, other)
    assert first.returncode == 20, first.stdout + first.stderr
    hint = shlex.split(re.search(r"Try (-o \S+)", first.stdout)[1])
    second = gate(project, folder, "--rules", "motor.count=30", *hint, other)
    assert second.returncode == 0, second.stdout + second.stderr
    assert gate(project, folder, "-o", "yapp.late:often", flights / "clean.pcapng").returncode == 21
    (folder / "mine").write_text("yapp.motor_ids: 0x310\n")
    assert gate(project, folder, "--preferences", "mine", "--rules", "motor.count=30", other).returncode == 0
    segments = tshark.CAPTURES / "cases/tcp_8_byte_segments.pcap"
    decoded = gate(project, folder, "--rules", "motor.count=1", "-d", "tcp.port==4001,yapp_serial", "-o",
                   "yapp.late:9", segments)
    assert decoded.returncode == 0, decoded.stdout + decoded.stderr


@pytest.mark.parametrize("words, said", [
    (["--rules"], "--rules: its value is missing"), (["--rules", "flight.rules"], "--rules flight.rules: no such file"),
    (["--rules", "fault"], "--rules fault: no such file"), (["--preferences", "no"], "no is no file that can be read"),
    (["-x", "1"], "-x is no option; options are --rules,"), (["-o"], "-o: its value is missing"),
    (["-o", "nonsense"], "-o nonsense: a preference is NAME:VALUE"), (["-d", "nonsense"], "-d nonsense: Decode As is TABLE==VALUE"),
    (["-d", "tcp.port==4001"], "-d tcp.port==4001: Decode As is"),
    (["-o", "yapp.messages:own.lua"], "-o yapp.messages is read too late: use --messages FILE")])
def test_options_that_are_none(folder, project, flights, words, said):
    done = gate(project, folder, flights / "clean.pcapng", *words)
    assert done.returncode == 2 and f"yapp-gate: {said}" in done.stderr, done.stderr


def programs(folder, *names):
    """A folder with these programs of the machine's, and no others."""
    place = folder / "bin"
    place.mkdir()
    for name in ("awk", "bash", "basename", "cat", "chown", "cp", "dirname", "env", "id", "mkdir", "mktemp", "nproc", "rm", "setpriv",
                 *names):
        (place / name).symlink_to(shutil.which(name, path=SYSTEM))
    return place


@pytest.mark.skipif(os.geteuid() != 0, reason="root installs")
def test_tshark_is_installed_where_there_is_none(folder, project, flights):
    place = programs(folder)
    (place / "apt-get").write_text(f'#!/bin/bash\necho "$@" >>{folder}/asked\n'
                                   f'[ "$1" = update ] || /bin/ln -s {shutil.which("tshark")} {place}/tshark\n')
    (place / "apt-get").chmod(0o755)
    for _ in range(2):  # the second time it is there
        done = run([place / "bash", project / "ci/yapp-gate.sh", *arguments(flights / "clean.pcapng")], folder, PATH=str(place))
        assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in (folder / "asked").read_text().splitlines()] == ["update", "install"]


# The jobs --------------------------------------------------------------------------------------------------------------

def block(text, key):
    """The lines of a block of YAML, without their indentation."""
    lines = text.splitlines()
    first = next(number for number, line in enumerate(lines) if line.strip() in (f"{key}:", f"{key}: |"))
    depth = len(lines[first]) - len(lines[first].lstrip())
    found = []
    for line in lines[first + 1:]:
        if line.strip() and len(line) - len(line.lstrip()) <= depth:
            break
        found.append(line)
    margin = min(len(line) - len(line.lstrip()) for line in found if line.strip())
    return [line[margin:] for line in found]


def variables(lines):
    return {name: value.strip('"') for name, value in (line.split(": ", 1) for line in lines)}


def action(project, given, folder):
    """A step of the action, as GitHub's runner does it; returns the exit code and its outputs."""
    text = (project / "action.yml").read_text()
    inputs = re.findall(r"^  (\w+):$", text.split("\noutputs:")[0], re.MULTILINE)
    assert sorted(inputs) == ["capture", "junit", "messages", "report", "rules", "sources", "waive"]
    values = {name: re.sub(r"\$\{\{ inputs\.(\w+) \}\}", lambda found: given.get(found[1], ""), value)
              for name, value in variables(block(text, "env")).items()}
    (folder / "step.sh").write_text("\n".join(block(text, "run")))
    (folder / "output").write_text("")
    done = run(["bash", "--noprofile", "--norc", "-eo", "pipefail", folder / "step.sh"], folder,
               GITHUB_ACTION_PATH=str(project), GITHUB_OUTPUT=str(folder / "output"), **values)
    return done.returncode, (folder / "output").read_text()


def test_the_action(folder, project, flights):
    given = {"capture": str(flights / "fault.pcapng"), "rules": RULES, "junit": "report/yapp.xml"}
    assert action(project, given, folder) == (20, "code=20\n")
    assert (folder / "report/yapp.xml").exists()


@pytest.mark.skipif(not shutil.which("git"), reason="no git here")
def test_the_job(folder, project, flights):
    """It clones the project, a repository with a tag for its version."""
    git = ["git", "-C", project, "-c", "user.name=t", "-c", "user.email=t@t", "-c", "safe.directory=*"]
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "x"], ["tag", f"v{tshark.plugin_version()}"]):
        subprocess.run([*git, *words], check=True)
    text = (project / "ci/gitlab-yapp.yml").read_text()
    lines = [line[2:] for line in block(text, "script")]
    assert lines[0].startswith("apt-get update")
    script = "\n".join(lines[1:]).replace("/tmp/yapp", str(folder / "clone"))
    given = {**variables(block(text, "variables")), "YAPP_REPOSITORY": f"file://{project}", "RULES": RULES,
             "CAPTURE": str(flights / "fault.pcapng"), "GIT_CONFIG_COUNT": "1", "GIT_CONFIG_KEY_0": "safe.directory", "GIT_CONFIG_VALUE_0": "*"}
    done = run(["bash", "-eo", "pipefail", "-c", script], folder, **given)
    assert done.returncode == 20, done.stdout + done.stderr
    assert (folder / "yapp.xml").exists()


# What docs/ci.md says ---------------------------------------------------------------------------------------------------

def test_the_step_and_the_commands_of_the_page(folder, project, flights):
    """The first in a clone, the others beside it.  The package has a test of `yapp-tables baseline`."""
    page = (tshark.ROOT / "docs/ci.md").read_text()
    shutil.copy(flights / "clean.pcapng", folder / "run.pcapng")
    lines = block(re.search(r"```yaml\n(.*?)```", page, re.DOTALL)[1], "with")
    assert action(project, variables(lines), folder) == (0, "code=0\n")
    assert (folder / "report.xml").exists()
    for name, target in (("yapp", project), ("flights", flights), ("bench.pcapng", flights / "fault.pcapng")):
        (folder / name).symlink_to(target)
    (project / "docs").symlink_to(tshark.ROOT / "docs")
    (folder / "flight.rules").write_text("fault=0\n")
    (folder / "waivers").write_text(re.search(r"(?m)^    # capture .*\n((?:    .*\n)+)", page)[1])
    names, commands = re.search(r"(?m)^NAMES=.*", page)[0], re.findall(r"(?m)^ *(\S*ci/yapp-gate\.sh .*)", page)
    codes = [run(["bash", "-c", f"{names}\n{command.replace('yapp-gate.sh --junit', 'yapp-gate.sh --waive waivers --junit')}"],
                 folder if command.startswith("yapp/") else project).returncode for command in commands]
    assert codes == [20, 0, 20, 0, 0]
