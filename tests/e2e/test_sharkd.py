# SPDX-License-Identifier: GPL-2.0-or-later
"""Frames asked for here and there, as sharkd's clients do: each is what it is in the whole capture."""
import json
import os
import shutil
import subprocess

import pytest

import levels
import stream_captures
import tshark

pytestmark = [levels.by_route, levels.without_tshark("runs sharkd, which is a program of its own"),
              pytest.mark.skipif(not shutil.which("sharkd"), reason="sharkd is not installed")]


@pytest.fixture
def home(folder):
    """sharkd loads plugins from its folder only."""
    tshark.install_plugin(folder / tshark.PERSONAL_FOLDER / "yapp")
    return folder


def filters_of(node):
    """The filter expressions of a tree, "yapp.size == 32"."""
    yield node.get("f", "")
    for child in node.get("n", []):
        yield from filters_of(child)


def answers_of(home, path, *calls):
    """What sharkd answers to calls, each { method, parameters }, after it has loaded a file."""
    calls = [load(path), *calls]
    lines = [json.dumps({"jsonrpc": "2.0", "id": at, "method": method, "params": parameters})
             for at, (method, parameters) in enumerate(calls, 1)]
    done = subprocess.run(["sharkd", "-"], input="\n".join(lines) + "\n", capture_output=True, text=True, check=True,
                          timeout=tshark.TIMEOUT, env={**os.environ, "HOME": str(home)}, **tshark._user())
    assert "Lua:" not in done.stderr, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert len(answers) == len(calls) and answers[0]["result"] == {"status": "OK"}, done.stdout
    return [answer.get("result") for answer in answers[1:]]


def load(path):
    return "load", {"file": str(path)}


def filters_in(answer):
    return {text for node in answer["tree"] for text in filters_of(node)}


def details(number):
    return "frame", {"frame": number, "proto": True}


def ask(home, path, frames):
    """What sharkd says of frames in this order: for each the filter expressions of its fields."""
    return [filters_in(answer) for answer in answers_of(home, path, *map(details, frames))]


def test_another_file(home):
    """A log names its bus; the pcap that is opened behind it names none, and a log behind that one its own."""
    log, pcap = tshark.CAPTURES / "candump/candump_log_plain.log", tshark.CAPTURES / "can/document_motor.pcap"
    answers = answers_of(home, log, details(1), load(pcap), details(5), load(log), details(1))
    found = [filters_in(answers[at]) for at in (0, 2, 4)]
    assert ['yapp.bus == "can0"' in one for one in found] == [True, False, True]
    assert not any("yapp.bus" in text for text in found[1]), found[1]


def test_one_filter_after_another(home):
    """What is wanted of a tree changes while the file is open: of these messages each has other flags."""
    path = tshark.CAPTURES / "can/fault_flags.pcap"
    asked = ["taurus.motor.fault.motor_overcurrent == 1", "taurus.motor.torque_iq_error", "taurus.motor.fault_flags == 0",
             "taurus.motor.fault.raised", "taurus.motor.fault.motor_overcurrent == 1"]
    answers = answers_of(home, path, *(("frames", {"filter": text}) for text in asked))
    for text, answer in zip(asked, answers):
        found = tshark.run("-r", path, "-Y", text).stdout
        assert [one["num"] for one in answer] == [int(line.split()[0]) for line in found.splitlines()], text
        assert answer, text


def test_a_file_that_does_not_open(folder, home):
    """What the capture is does not follow the first bytes of the other (as of one only looked at in a file dialog)."""
    packets = []
    for number, fault in enumerate((0, 0, 1, 1)):  # fault flags, bit 0; two serial lines in turns
        payload = bytes(18) + bytes([fault]) + bytes(13)
        place = stream_captures.Origin(stream_captures.EXPORTED_PDU, number % 2, 0)
        packets.append(stream_captures.Packet(stream_captures.frame(0x210, payload), place))
        packets[-1].time = stream_captures.EPOCH + number * 1000
    path, other = folder / "two.pcapng", folder / "other.txt"
    stream_captures.Capture("", packets, None, []).write(path)
    other.write_text("no capture")
    before, refused, after = answers_of(home, path, details(3), load(other), details(3))
    assert refused is None and filters_in(after) == filters_in(before)
    assert "taurus.motor.fault.raised == 0x00000001" in filters_in(before)
