#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Messages of the user's own: where they are loaded from, every type of field, and docs/messages.md.

    test_messages.py    writes NAME.pcap and NAME.expected of test_captures/own_messages, and what the page's commands print, anew:
                        look at the difference"""
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest

import levels
import tshark

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test_captures"))
import expected  # noqa: E402
import make  # noqa: E402

OWN = tshark.CAPTURES / "own_messages"
CATALOGUE = OWN / "messages.lua"
NAMES = sorted(path.stem for path in OWN.glob("*.frames"))
PERSONAL = pathlib.Path(".config/wireshark")  # in a home


@pytest.fixture
def own(monkeypatch):
    monkeypatch.setenv("YAPP_MESSAGES", str(CATALOGUE))


def pcap(name):
    return make.pcap(make.Source((OWN / f"{name}.frames").read_text()))


def shown(name, *options):
    """The Taurus tree and the Info column of each frame."""
    path = OWN / f"{name}.pcap"
    done = tshark.run(*options, "-o", 'gui.column.format:"Info","%i"', "-r", path, "-P", "-O", "taurus")
    packets = re.findall(r"(?m)^(.*)\nFrame (\d+): .*\n(?:\S.*\n)*?(Taurus .*\n(?:    .*\n)*)", done.stdout)
    lines = []
    for info, number, block in packets:
        kept = [line for line in block.splitlines() if not re.match(r" +\[(Severity|Group|[^\]:]*\]$)", line)]
        lines += [f"frame {number}: {info}", *(f"    {line}".rstrip() for line in kept)]
    # What is new since the message before it is another test's.
    news = r" +\[(.* (raised|cleared): |Time since |.* (change|raised|cleared) in: |Clock drift|Expert Info .*: A fault was )"
    text = "".join(f"{line}\n" for line in lines if not re.match(news, line))
    text = re.sub(r"(\[Faults: \w.*?)(, raised here|;.* here)\]", r"\1]", text)
    # Versions differ in the digits of very large and very small numbers, and of times.
    text = re.sub(r"\b\d[.\d]*e[-+]\d+", lambda match: f"{float(match[0]):.6g}", text)
    return re.sub(r"(?m)(\d[.\d]*) seconds?$", lambda match: f"{float(match[1]):.9f} seconds", text)


# The types -------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", NAMES)
@levels.without_tshark("compares two files")
def test_the_text_makes_the_capture(name):
    assert (OWN / f"{name}.pcap").read_bytes() == pcap(name)


@levels.by_version
@levels.each_once
@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two passes"])
@pytest.mark.parametrize("name", NAMES)
def test_tree_and_info(name, passes):
    assert shown(name, *passes) == (OWN / f"{name}.expected").read_text()


# Capture, display filter, its frames: of each kind of value.
FILTERS = [
    ("unsigned", "taurus.unsigned.u64 == 18446744073709551615", [3]), ("signed", "taurus.signed.i64 < -9223372036854775807", [4]),
    ("real", "taurus.real.f64.special == 0", [4]), ("real", "taurus.real.f32 > 0 || taurus.real.f32 <= 0", [1, 2, 3, 7]),
    ("compressed", "taurus.compressed.c32 == 1", [2]), ("odd", "taurus.odd.i40 < 0", [2, 4]),
    ("scaled", "taurus.scaled.latitude == 47.3979147", [1]), ("scaled", "taurus.scaled.gradient == -98", [1]),
    ("word", "taurus.value.invalid", [3]), ("word", "taurus.word.word.undefined", [4]),
    ("text", 'taurus.text.name == "ESC 1"', [1]), ("text", "taurus.text.key == ff:fe:7f:80", [2]),
]


@levels.by_version
@pytest.mark.usefixtures("own")
@pytest.mark.parametrize("name, text, frames", levels.few(FILTERS, FILTERS[-4:], several=True), ids=lambda value: value if isinstance(value, str) else "")
def test_a_filter_alone(name, text, frames):
    """Nothing else is wanted of the tree."""
    found = tshark.run("-r", OWN / f"{name}.pcap", "-Y", text).stdout
    assert [int(line.split()[0]) for line in found.splitlines()] == frames


# Where they are loaded from --------------------------------------------------------------------------------------

ENTRY = ('return {{ {{ name = "{name}", title = "{title}", id = {ident}, size = 7, {{ "one", "uint8", "One" }}, '
         '{{ "rest", "bytes", "Rest", length = 6 }} }} }}')
COMMAND = tshark.CAPTURES / "can/document_command.pcap"


def home_with(folder, files):
    """A home with these files in Wireshark's personal configuration folder, and the arguments that load the plugin."""
    (folder / PERSONAL).mkdir(parents=True)
    for name, text in files.items():
        (folder / PERSONAL / name).write_text(text)
    plugin = tshark.copy_plugin(folder / "plugin")
    tshark.open_to_all(folder)
    return {"plugin": False, "env": {"HOME": str(folder)}}, tshark.load(plugin / "yapp.lua")


def loaded(folder, files, *arguments, env=None):
    """What the Info column says of a Command, and what the plugin says on stderr."""
    options, load = home_with(folder, files)
    options["env"].update(env or {})
    done = tshark.run(*load, "-r", COMMAND, "-T", "fields", "-e", expected.column("Info"), *arguments, **options)
    return done.stdout.strip(), [line for line in done.stderr.splitlines() if line.startswith("yapp: ")]


# The file in the personal folder; another by a preference, by the environment; and one by a preference for one run.
@pytest.mark.parametrize("way, wanted", [("folder", "Mine"), ("preference", "Chosen"), ("environment", "Chosen"), ("-o", "Command  Enabled")])
def test_where_messages_are_loaded_from(folder, way, wanted):
    path = folder / "elsewhere.lua"
    path.write_text(ENTRY.format(name="command", title="Chosen", ident=0))
    files = {} if way == "-o" else {"yapp_messages.lua": ENTRY.format(name="command", title="Mine", ident=0)}
    files |= {"preferences": f"yapp.messages: {path}\n"} if way == "preference" else {}
    info, said = loaded(folder, files, *(["-o", f"yapp.messages:{path}"] if way == "-o" else []),
                        env={"YAPP_MESSAGES": str(path)} if way == "environment" else None)
    assert info.startswith(wanted)
    assert said == ([f"yapp: preferences: {path} is read at the next start, if the default profile names it; for one run "
                     "set the environment variable YAPP_MESSAGES to it"] if way == "-o" else [])


# Payloads of another size ------------------------------------------------------------------------------------------

MOTOR = "FD7FFD7FFD7FFD7FF5AFFD7F18010000014000000000E38CD23CE04E000005FF"
FAULTY = MOTOR[:40] + "01" + MOTOR[42:]  # motor_overcurrent
LINKS = {"can": "can0", "pdu": ">", "udp": ">", "tcp": "<"}  # in UDP and TCP an address is one source


def together(folder, *messages):
    """Messages on CAN, a UART, UDP and TCP, one after the other in one file; and in which frame each of them ends."""
    sources, ends, before = [], [], 0
    for link, source in LINKS.items():
        sources.append(make.Source(f"link {link}\n" + "".join(f"{source} [{one}]\n" for one in messages)))
        ends.append([before + message["frame"] for message in sources[-1].messages])
        before += len(sources[-1].packets)
    path = folder / "together.pcapng"
    path.write_bytes(make.pcapng(*sources))
    return path, ends


@levels.by_version
@pytest.mark.parametrize("passes", [(), ("-2",)], ids=["one pass", "two passes"])
def test_a_firmware_that_appends_fields(folder, passes):
    """On every link what the catalogue knows is decoded and counted, and the rest is bytes; not where the CRC is bad."""
    path, ends = together(folder, f"210 {FAULTY}DEADBEEF", f"210 {MOTOR}00", f"!210 {FAULTY}DEADBEEF", f"210 {MOTOR[:62]}")
    names = ["taurus.motor.dc_voltage", "taurus.motor.fault.motor_overcurrent", "yapp.message.fault", "yapp.undecoded",
             "yapp.size.mismatch", "yapp.payload", expected.column("Info")]
    rows = tshark.fields(path, names, *passes, separator="|")
    info = "{}Motor Data{}  0.0/0.0 RPM  47.97 V  0.00 A{}  [{} bytes, {} not decoded]"
    for link, frames in zip(LINKS, ends):
        faulty, well, bad, short = [rows[number - 1] for number in frames]
        # In one run several buses have the ID: Info says which.
        where = re.search(r"Motor Data(.*?)  0", faulty[-1])[1]
        assert faulty[:-1] == ["47.97314", *["1" if tshark.version() < (4, 2) else "True"] * 2, "deadbeef", "1", ""], link
        assert faulty[-1] == info.format("FAULT motor_overcurrent  ", where, "", 36, 4), link
        assert well[3:] == ["00", "1", "", info.format("cleared motor_overcurrent  ", where, "  STALE", 33, 1)], link
        assert bad[:4] == ["", "", "", ""], link
        if link == "can":  # in a stream it is no frame
            assert bad[4:] == ["1", f"{FAULTY}deadbeef".lower(), f"BAD CRC  Motor Data{where}, 36 bytes, the catalogue says 32"]
        assert short[:5] == ["", "", "", "", "1"] and short[5] == MOTOR[:62].lower(), link
    found = [json.loads(line) for line in tshark.run("-q", *passes, "-r", path, "-z", "yapp,faults,json", check=False).stdout.splitlines()]
    assert [(one["frame"], one["event"]) for one in found] == [
        (frames[place], event) for frames in ends for place, event in enumerate(["raised", "cleared"])]


# docs/messages.md ------------------------------------------------------------------------------------------------

PAGE = tshark.ROOT / "docs/messages.md"


def page_of(folder):
    """The page, with what its commands print in a real shell where its file is installed."""
    page = PAGE.read_text()
    options, load = home_with(folder, {"yapp_messages.lua": re.search(r"(?s)```lua\n(.*?)```", page)[1]})
    wrapper = folder / "bin/tshark"
    wrapper.parent.mkdir()
    wrapper.write_text(f'#!/bin/sh\nexec {shutil.which("tshark")} {" ".join(load)} "$@"\n')
    wrapper.chmod(0o755)
    environment = {**os.environ, **options["env"], "LC_ALL": "C.UTF-8", "TZ": "UTC",
                   "PATH": f"{wrapper.parent}:{os.environ['PATH']}"}
    for name in ("XDG_CONFIG_HOME", "YAPP_MESSAGES"):
        environment.pop(name, None)

    def run(match):
        done = subprocess.run(["bash", "-c", match[2]], cwd=folder, env=environment, capture_output=True, text=True,
                              timeout=tshark.TIMEOUT, **tshark._user())
        assert done.returncode == 0 and "Lua" not in done.stderr, done.stderr
        return match[1] + "".join(f"    {line}\n" for line in done.stdout.rstrip().splitlines())

    text, count = re.subn(r"(?m)^(    \$ (.*)\n)(?:    .*\n)*", run, page)
    assert count >= 4
    return text


def test_the_page_about_messages(folder):
    assert page_of(folder) == PAGE.read_text(), "run make regenerate"


if __name__ == "__main__":
    place = tshark.writable_folder()
    PAGE.write_text(page_of(place))
    shutil.rmtree(place)
    os.environ["YAPP_MESSAGES"] = str(CATALOGUE)
    for one in NAMES:
        (OWN / f"{one}.pcap").write_bytes(pcap(one))
        (OWN / f"{one}.expected").write_text(shown(one))
