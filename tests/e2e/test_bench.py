# SPDX-License-Identifier: GPL-2.0-or-later
"""The arithmetic of make bench, with figures made up; that its programs run on a few messages.  Nothing here is timed."""
import importlib.util
import pathlib
import subprocess
import sys
import types

import pytest

import levels
import tshark

sys.path.append(str(tshark.ROOT / "tests/bench"))
import bench  # noqa: E402
import report  # noqa: E402
import traffic  # noqa: E402
import works  # noqa: E402
from report import Usage  # noqa: E402

NOWHERE = pathlib.Path("/nowhere")


def cpu(*seconds):
    return [Usage(one, 1e6) for one in seconds]


def test_peers_take_turns_and_one_that_fails_is_left_out():
    calls = []

    def run(command):
        calls.append(command)
        if command == "b":
            raise bench.NotMeasured("b is not there")
        return Usage(1.0, 2.0)

    work = works.Work("w", {"now": "a", "none": "b", "script": "c", "floor": "d"})
    assert bench.measure_work(work, {"floor": "no floor"}, 2, run) == {
        "now": [Usage(1.0, 2.0)] * 2, "none": "b is not there", "script": [Usage(1.0, 2.0)] * 2, "floor": "no floor"}
    assert calls == ["a", "b", "c", "a", "c"]


@pytest.mark.parametrize("now, isotp, cells", [
    (cpu(9.0, 3.0, 4.0), cpu(2.0, 2.0, 1.0), ["2.00", "yes"]),
    (cpu(3.73), cpu(1.15), ["3.24", "no"]),
    (cpu(3.73), "no ISO-TP", ["", "not measured: no ISO-TP"]),
    ("no plugin", cpu(1.15), ["", "not measured: no plugin"]),
])
def test_ratio_of_medians_and_verdict(now, isotp, cells):
    work = works.Work("w", {}, works.Target("isotp", 2.0))
    row = report.ratio_row({"w": {"now": now, "isotp": isotp}}, work, ["isotp"])
    assert row == ["w", cells[0], "<= 2x ISO-TP", cells[1]]


def test_difference():
    work = works.Work("w", {}, works.Target("none", 0.04, difference=True))
    row = report.ratio_row({"w": {"now": cpu(0.27), "none": cpu(0.2)}}, work, ["none"])
    assert row == ["w", "+0.07 s", "<= +0.04 s", "no"]


def test_memory_is_over_none_of_the_same_work_or_of_the_packet_list():
    results = {works.LIST: {"none": [Usage(1, 100)], "isotp": [Usage(1, 148)], "now": [Usage(1, 137)]},
               works.VERBOSE: {"none": [Usage(1, 110)], "now": [Usage(1, 160)]}, works.TABLES: {"now": [Usage(1, 150)]}}
    assert report.over_none(results, works.LIST, "now") == 37
    assert report.over_none(results, works.VERBOSE, "now") == 50
    assert report.over_none(results, works.VERBOSE, "isotp") == 48
    assert report.over_none(results, works.TABLES, "now") == 50
    assert report.over_none(results, works.FILTER, "now") is None


def test_growth_is_of_a_frame():
    results = {works.LONG_LIST: {"now": [Usage(44, 1300)], "now short": [Usage(4, 200)],
                                 "none": [Usage(9, 400)], "none short": [Usage(1, 100)]}}
    assert report.growth_row(results, "now", True) == ["now", "1.10", "0.90", "no / yes"]


def test_the_parts_of_the_time_are_all_of_it():
    times = [dict(file=0.1, reassembly=0.4, values=0.5, history=0.5, info=0.6)]
    pure = report.steps(times)
    assert pure == pytest.approx(dict(reassembly=0.3, values=0.1, history=0, info=0.1))
    results = {works.LIST: dict(none=cpu(1), empty=cpu(1.2), floor=cpu(1.5), asked=cpu(1.7), now=cpu(3)),
               works.START: dict(none=cpu(0.2), now=cpu(0.25))}
    rows = dict(report.where(results, pure, 10_000))
    assert rows["all"] == pytest.approx(300)
    assert sum(rows.values()) == pytest.approx(2 * rows["all"])
    assert rows["the rest: what joins these, and that Lua shares the caches"] == pytest.approx(75)


def test_a_report_of_nothing_says_why():
    results = {work.title: {peer: "tshark is not there" for peer in work.commands}
               for work in works.works(works.Shark(NOWHERE, NOWHERE), "python3", 10)}
    options = types.SimpleNamespace(messages=10)
    text = bench.text(options, "", works.works(works.Shark(NOWHERE, NOWHERE), "python3", 10), results, {})
    assert text.count("| not measured: tshark is not there |") == len(results) + len(report.MEMORY)


def test_another_version_has_its_own_plugin_and_nothing_else():
    work = works.works(works.Shark(tshark.ROOT, NOWHERE), "python3", 10)[0]
    both = works.with_version(work, tshark.ROOT, NOWHERE).commands
    assert both["before"] == [word.replace(str(tshark.ROOT), str(NOWHERE)) for word in work.commands["now"]] != both["now"]
    assert {**both, "before": None} == {**work.commands, "before": None}


@pytest.mark.parametrize("lua", ["lua5.2", "lua5.4"])
def test_the_pure_parts_find_every_message(lua, folder):
    capture = traffic.make(folder / "few", 60) / "yapp.pcap"
    done = subprocess.run([lua, str(bench.HERE / "parts.lua"), str(capture)], capture_output=True, text=True, check=True)
    names = [line.split("\t")[0] for line in done.stdout.splitlines()]
    assert names == ["file", *report.STEPS, "messages"] and done.stdout.endswith("messages\t60\n")


def test_what_is_written_by_hand_has_the_same_values(folder):
    shark = works.Shark(tshark.PLUGIN, traffic.make(folder / "few", 60))
    flag = ["-e", works.FAULT, "-e", "taurus.motor.rpm_error"]
    commands = shark.hand(*works.VALUE_FIELDS, *flag), shark.now("yapp.pcap", *works.VALUE_FIELDS, *flag)
    rows = [tshark.run(*command[1:], plugin=False).stdout for command in commands]
    assert rows[0] == rows[1] and len(set(rows[0].split())) > 500


@levels.deep
def test_every_command_shows_something(folder):
    pytest.importorskip("can")
    shark = works.Shark(tshark.PLUGIN, traffic.make(folder / "few", 10))
    asked = [*works.works(shark, sys.executable, 10), *works.long_works(shark, shark, sys.executable)]
    if not importlib.util.find_spec("yapp_tables"):
        asked = [work for work in asked if "yapp-tables" not in work.title]
    assert [why for why in bench.try_out(asked, {"now": shark}).values() if why] == []
