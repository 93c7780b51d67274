# SPDX-License-Identifier: GPL-2.0-or-later
"""The page names whom an incident hit, with what it was, and nobody else. planted.py judges more flights."""

import json
import re
import subprocess
import zipfile

import aircraft
import pairs
import planted
import pytest
import yapp_tables as yt
from running import PLUGIN, run_tables
from yapp_tables import verdict


@pytest.mark.parametrize(
    ("seed", "kinds"), [(1, planted.KINDS), (2, ()), (3, ("disabled", "lost", "sag")), (4, ("load", "hot", "disabled"))]
)
def test_nobody_else_is_accused(tmp_path, seed, kinds):
    truth, lines = planted.judge(tmp_path, seed, 150.0, kinds)
    guilty = {"Battery" if name == "battery" else name for name, *_ in truth.values()}
    assert set(lines) == guilty, lines
    for kind, (name, *_) in truth.items():
        assert re.search(planted.WORDS[kind], lines["Battery" if name == "battery" else name]), (kind, lines)
    page = (tmp_path / "page.html").read_text()
    if "overcurrent" in truth:  # the card says the same of the current before the fault
        before = re.search(r"from (\d\.\d{3}) s before", lines[truth["overcurrent"][0]])[1]
        assert re.search(rf"(?m)^-{before} .* dc_current ", page), before
    (cloud,) = json.loads(re.search(r'id="data">(.*?)</script>', page)[1])["clouds"]
    odd = [truth["load"][0]] if "load" in truth else []
    assert re.findall(r"(\w+) \(can\d\), [\d.]+ beside [\d.]+ A", cloud["said"]) == odd, cloud["said"]
    verdict = re.sub("<.*?>", "", re.search(r'<p id="verdict">(.*?)</p>', page)[1])
    if not truth:
        assert verdict.startswith("GOOD: no fault, reboot, silence or odd controller"), verdict
    else:
        assert verdict.startswith("NOT GOOD: "), verdict
    assert verdict.endswith("; all decoded."), verdict


def test_what_begins_in_flight_is_found_with_its_time(tmp_path):
    """A propeller breaks in the middle of a flight: 40 % less load from then on."""
    capture = aircraft.write(tmp_path / "run.pcapng", "four large", 9412, "propeller")
    options = aircraft.options("four large")
    run_tables(tmp_path, "report", "run.pcapng", "--out", "page.html", "--plugin", PLUGIN, *options, code=0)
    lines = planted.causes((tmp_path / "page.html").read_text())
    times = yt.read(capture, options=options[1::2], plugin=PLUGIN)["motor"]["time"].to_pylist()
    length = (max(times) - min(times)).total_seconds()
    assert list(lines) == ["m1"], lines
    found = re.fullmatch(r"(\d+)% less current from 0:(\d\d) to 0:(\d\d) \(.* A\)\.", lines["m1"])
    share, begin, end = map(int, found.groups())
    assert abs(share - 40) < 5
    assert abs(begin - length / 2) < 2
    assert abs(end - length) < 3


def test_a_fault_for_the_vendor(tmp_path):
    """Of the controller, its Commands and nobody else: whole messages, from 2 s before to 2 s behind the fault."""
    name, begin, end = planted.write(tmp_path / "run.pcapng", 5, 60.0, ("overcurrent",))["overcurrent"]
    run_tables(tmp_path, "case", "run.pcapng", "1", "--out", "case.zip", "--plugin", PLUGIN, *planted.OPTIONS, code=0)
    with zipfile.ZipFile(tmp_path / "case.zip") as archive:
        archive.extractall(tmp_path)
    card = json.loads((tmp_path / "card.json").read_text())
    assert (card["source"], card["flags"][0]["flag"]) == (name, "motor_overcurrent")
    assert "Left its range" in (tmp_path / "card.txt").read_text()
    assert "plugin: 3." in (tmp_path / "versions.txt").read_text()
    assert "card of the fault" in (tmp_path / "page.html").read_text()
    part = yt.read(tmp_path / "frames.pcapng", options=planted.OPTIONS[1::2], plugin=PLUGIN)
    assert part.left_out == []
    end_of_bus = planted.ENDS[planted.NAMES.index(name) // 4]
    assert {row["source"] for row in part.summary.to_pylist()} == {name, end_of_bus}
    assert sum(row["incomplete"] for row in part.summary.to_pylist()) == 0
    first = yt.read(tmp_path / "run.pcapng", options=planted.OPTIONS[1::2], plugin=PLUGIN)["command"]["time"][0].value
    times = [(time.value - first) / 1e9 for message in part.values() for time in message["time"]]
    assert begin - 2.11 < min(times) < begin - 1.8, times
    assert end + 1.8 < max(times) < end + 2.2, times
    done = run_tables(tmp_path, "case", "run.pcapng", "2", "--out", "no.zip", "--plugin", PLUGIN, *planted.OPTIONS)
    assert (done.returncode, "run.pcapng has no fault 2" in done.stderr) == (1, True), done.stderr
    assert not list(tmp_path.glob("no.zip*"))


def test_what_comes_many_times_is_one_sentence(tmp_path):
    pairs.write(tmp_path / "run.pcapng", "often", {1: {"flag": 0.02}}, 80.0)
    run_tables(tmp_path, "report", "run.pcapng", "--out", "page.html", "--plugin", PLUGIN, *pairs.OPTIONS, code=0)
    line = planted.causes((tmp_path / "page.html").read_text())["fr"]
    span = r"[01]:\d\d\.\d{3}"
    assert re.fullmatch(rf"Motor overcurrent, Faulted \d+ times, {span} to {span}, at most \d+\.\d{{3}} s\.", line), (
        line
    )


def test_a_bus_that_was_silent_is_one_sentence(tmp_path):
    planted.write(tmp_path / "whole.pcapng", 8, 60.0, ())
    silent = "frame.time_relative > 30 && frame.time_relative < 32 && frame.interface_name == can1 && can.id != 0"
    cut = ["tshark", "-r", tmp_path / "whole.pcapng", "-Y", f"!({silent})", "-w", tmp_path / "run.pcapng"]
    subprocess.run(cut, check=True, capture_output=True)
    run_tables(tmp_path, "report", "run.pcapng", "--out", "page.html", "--plugin", PLUGIN, *planted.OPTIONS, code=0)
    lines = planted.causes((tmp_path / "page.html").read_text())
    assert list(lines) == ["can1"], lines
    assert re.fullmatch(r"silence of all 4 controllers 2\.\d{3} s at 0:29\.\d{3}\.", lines["can1"]), lines
    phases = re.search(r'<p id="phases".*?>(.*?)</p>', (tmp_path / "page.html").read_text())[1]
    names = ", ".join(f"{name} (can{name[0] == 'R':d})" for name in planted.NAMES)
    assert phases.startswith(f"No findings about {names}, the buses. In flight (by speed) "), phases


def test_a_silence_of_damaged_messages_says_so():
    def incident(kind, begin, until, **more):
        rows = [{"kind": kind, "source": "left", "is_command": False, **more}]
        about = {"label": "left (can0)", "source": "left", "what": kind, "is_fault": False, "kinds": [kind]}
        return about | {"begin": begin, "until": until, "rows": rows, "is_serious": kind == "silence"}

    rows = [incident("silence", 9.9, 10.4), incident("crc", 8.0, 10.2, at=[8.0, 10.0, 10.1, 10.2])]
    said = verdict.causes({"incidents": rows, "differs": [], "length": 60.0})
    assert [one["text"] for one in said["left (can0)"]] == [
        "silent 0.500 s, from 0:09.900, in which 3 damaged messages came"
    ]
    rows[0]["rows"].append({"kind": "silence", "source": "left", "is_command": True})
    said = verdict.causes({"incidents": rows[:1], "differs": [], "length": 60.0})
    assert said["left (can0)"][0]["text"] == "silent 0.500 s, from 0:09.900; Commands lost, too"


def test_a_message_that_came_damaged_is_counted_once():
    """Of one source 3 of 5 missing ones came with a bad CRC; of the other 2 are incomplete."""
    counts = [("left", "crc", 3), ("left", "missing", 5), ("right", "incomplete", 2)]
    rows = [{"label": label, "kind": kind, "count": count} for label, kind, count in counts]
    incidents = [{"is_fault": False, "is_serious": False, "kinds": [], "rows": rows}]
    said = verdict.headline({"incidents": incidents, "differs": [], "left_out": []})
    assert said == ("GOOD", "no fault, reboot, silence or odd controller, 7 messages damaged or lost")
