# SPDX-License-Identifier: GPL-2.0-or-later
"""Flights with planted events come out of -z yapp,... exactly: in one pass and in two, in every form of capture.

YAPP_FLIGHTS=100: more seeds.
"""
import collections
import csv
import functools
import itertools
import json
import os
import re
from decimal import Decimal

import pytest

import flights
import levels
import model
import published
import tshark

SEEDS = range(1, int(os.environ.get("YAPP_FLIGHTS", levels.size(3, 4))) + 1)
HAVE_FAULTS = [message.name for message in model.MESSAGES.values() if message.alarms]
PASSES = {"one pass": (), "two passes": ("-2",)}
CASES = [(seed, flights.FORMS[seed % 3], passes) for seed in SEEDS for passes in PASSES]
CASES += [(1, flights.LATE_PCAPNG, passes) for passes in PASSES]
# A first pass has the fields that a filter names, and here not all that tell the bus.
PASSES["half told"] = ("-2", "-Y", "frame.interface_id == 0")
CASES += [(1, "sll2", "half told")]
ONCE = [case for at, case in enumerate(CASES) if at % 2 == at // 2 % 2]  # each flight and form, in one pass or in two
assert {case[:2] for case in ONCE} == {case[:2] for case in CASES}
CHECKED = pytest.mark.parametrize("seed, form, passes", levels.few(CASES, [*ONCE, CASES[-1]], several=True))


@functools.lru_cache(None)
def flight_of(seed):
    return flights.make(seed)


def statistics(flight, form, capture, *whats, passes=(), check=True):
    """The JSON lines of some statistics, by kind; and the exit code."""
    taps = [argument for what in whats for argument in ("-z", f"yapp,{what}")]
    done = tshark.run(*passes, *flight.arguments(form), "-q", "-r", capture, *taps, check=check)
    found = {name: [] for name in model.STATISTICS}
    found["titles"] = [line for line in done.stdout.splitlines() if line.startswith("YAPP ")]
    for text in (line for line in done.stdout.splitlines() if line.startswith("{")):
        line = json.loads(text, parse_float=Decimal)
        kind = "compare" if "spread" in line else "events" if "kind" in line else "faults" if "event" in line else "check" if "rule" in line else \
            "csv" if "rows" in line else "summary"
        found[kind].append(line)
    said = [line for line in done.stderr.splitlines() if line.startswith("yapp:") and "-Y does not narrow" not in line]
    is_about_faults = any(re.search(r"^faults|\bfault=|^check(,json)?$", what) for what in whats)
    assert_left_out(said, flight.truth(form), is_about_faults)
    return found, done.returncode


def assert_left_out(said, truth, is_about_faults):
    """What the answers say that they leave out: messages that were not decoded, and those that may hide a fault."""
    events = truth["events"]
    unknown = sum(line["count"] for line in events if line["kind"] == "unknown")
    hiding = {row["name"]: row["hides"] for row in published.inventory()["kinds"] if row["hides"]}
    counts = {text: sum(line.get("count", 1) for line in events if line["kind"] == kind and line["message"] in (None, *HAVE_FAULTS))
              for kind, text in hiding.items()}
    counts["missing by their period"] = truth["missing_by_period"]
    hiding = ", ".join(f"{count} {text}" for text, count in counts.items() if count)
    expected = [f"yapp: {unknown} message"] * bool(unknown)
    expected += [f"yapp: damaged or lost messages may hide faults: {hiding}"] * bool(is_about_faults and hiding)
    assert [line[:len(start)] for line, start in zip(said, expected)] == expected and len(said) == len(expected), said


def seconds(nanoseconds):
    return None if nanoseconds is None else Decimal(nanoseconds).scaleb(-9)


def with_times(lines):
    """The truth's nanoseconds as the seconds that JSON has."""
    return [{key: seconds(value) if key in ("time", "active", "length") else value for key, value in line.items()}
            for line in lines]


def sort_key(line):
    return json.dumps({key: str(value) for key, value in line.items()}, sort_keys=True)


def assert_close(found, expected, what, limit=1e-9):
    assert (found is None) == (expected is None), what
    assert found is None or abs(float(found) - float(expected)) <= limit * max(1.0, abs(float(expected))), what


@pytest.fixture(scope="module")
def results():
    """Each capture is read once for all statistics."""
    folder = tshark.writable_folder()

    @functools.lru_cache(None)
    def get(seed, form, passes):
        flight = flight_of(seed)
        capture = flight.write(folder / f"{seed}.{form}.{'log' if form == 'candump' else 'pcapng'}", form)
        table = folder / f"{seed}.{form}.{passes}".replace(" ", "")
        return run_all(flight, form, capture, table, PASSES[passes]), table, capture

    return get


def run_all(flight, form, capture, table, passes):
    """The lines of three statistics, one more as text, and the table of another, from one run."""
    found, code = statistics(flight, form, capture, "events,json", "faults,json", "summary,json", "faults",
                             f"csv,{table},json", passes=passes, check=False)
    assert code == (21 if unknown_sources(flight.truth(form)) else 0)  # of faults
    return found


def unknown_sources(truth):
    """How many sources have messages that were not decoded."""
    return len({(line["bus"], line["id"]) for line in truth["events"] if line["kind"] == "unknown"})


@CHECKED
def test_events(results, seed, form, passes):
    found = results(seed, form, passes)[0]["events"]
    expected = with_times(flight_of(seed).truth(form)["events"])
    assert [line["time"] for line in found] == sorted(line["time"] for line in found)
    kinds = [line["kind"] for line in found]
    assert "absent" not in kinds[:len(kinds) - kinds.count("absent")]
    keys = {key for line in expected for key in line}
    found = [{key: value for key, value in line.items() if key in keys} for line in found]
    assert sorted(found, key=sort_key) == sorted(expected, key=sort_key)


@CHECKED
def test_faults(results, seed, form, passes):
    found = results(seed, form, passes)[0]["faults"]
    expected = with_times(flight_of(seed).truth(form)["faults"])
    assert len(found) == len(expected) and all(line.items() >= truth.items() for line, truth in zip(found, expected))


def incidents(faults):
    """How often a source had a fault: the lines of one message are one step."""
    active, count = collections.defaultdict(set), 0
    for (_, bus, ident), lines in itertools.groupby(faults, lambda line: (line["frame"], line["bus"], line["id"])):
        lines, before = list(lines), set(active[bus, ident])
        flags = active[bus, ident]
        flags |= {(line["field"], line["flag"]) for line in lines if line["event"] == "raised"}
        flags -= {(line["field"], line["flag"]) for line in lines if line["event"] == "cleared"}
        count += not before and any(line["event"] == "raised" for line in lines)
    return count


@CHECKED
def test_the_title_of_faults(results, seed, form, passes):
    truth = flight_of(seed).truth(form)
    expected, unknown = incidents(truth["faults"]), unknown_sources(truth)
    title = f"UNKNOWN, {unknown} of {len(truth['summary'])} sources not decoded, {expected} in what was decoded" if unknown else expected
    assert results(seed, form, passes)[0]["titles"] == [f"YAPP faults: {title}"] and 0 < expected < len(truth["faults"])


@CHECKED
def test_summary(results, seed, form, passes):
    def key(line):
        return (line["bus"] or "", line["id"], line["count"], line["gap_max_frame"] or 0)

    found = sorted(results(seed, form, passes)[0]["summary"], key=key)
    expected = sorted(flight_of(seed).truth(form)["summary"], key=key)
    assert len(found) == len(expected)
    for line, truth in zip(found, expected):
        for name, value in truth.items():
            if name in ("rate", "gap_min", "gap_mean", "gap_max"):
                scale = 1 if name == "rate" else Decimal(10) ** -9
                assert_close(line[name], None if value is None else Decimal(value) * scale, (name, truth))
            elif name == "values":
                assert line[name].keys() == value.keys()
                for field, of_field in value.items():
                    for end, number in of_field.items():
                        # The ends of a range have the seven digits of a value; a difference has those of its two.
                        limit = 5e-4 if any(field in message.generated for message in model.MESSAGES.values()) else 5e-7
                        assert_close(line[name][field][end], number, (field, end, truth), limit)
            elif isinstance(value, (float, Decimal)):
                assert_close(line[name], value, (name, truth))
            else:
                assert line[name] == value, (name, truth)


def check_row(row, frame, bus, source, message):
    """A row of a table against the message that was sent."""
    who = {"time": f"{frame.at // flights.SECOND}.{frame.at % flights.SECOND:09d}", "frame": str(frame.number),
           "bus": bus or "", "source": source or "", "id": str(message.sender.ident), "seq": str(message.seq)}
    assert {name: row[name] for name in who} == who
    for field, size, kind, count in message.sender.message.counts(message.payload):
        if kind is None:
            assert Decimal(row[field]) == seconds(count - (count >> 63 << 64))
        elif model.is_float(kind):
            special = 2 ** (8 * size) - 1 - count
            if special < 5:
                assert (row[field], row[f"{field}_special"]) == ("", ["nan", "inf", "-inf", "above", "below"][special])
            else:
                assert float(row[field]) == pytest.approx(model.value(count, size, kind[0], kind[1]), rel=1e-6, abs=1e-9)
                assert row[f"{field}_special"] == ""
        elif isinstance(kind, model.Number) and kind.column != "integer":
            assert (row[field] if kind.column == "string" else float(row[field])) == pytest.approx(kind.value(count, size))
        else:
            assert int(row[field]) == count
        if field in model.MEANINGS:
            assert row[f"{field}_text"] == model.MEANINGS[field].get(count, "")
        for bit, flag in (kind[1] if kind and model.is_flags(kind) else {}).items():
            assert row[f"{kind[0]}_{flag}"] == ("1" if count & bit else "0")
    ident = flights.KIND[message.sender.kind]
    values = model.generated(ident, message.payload)
    for name in model.MESSAGES[ident].derived:
        value = values.get(f"taurus.{model.MESSAGES[ident].name}.{name}")
        assert row[name] == "" if value is None else float(row[name]) == pytest.approx(value, rel=1e-6, abs=1e-9)


def check_fields(described):
    """fields.json against the document's tables: units, filters, and of integers how wide they are."""
    for name, _, fields in model.MESSAGES.values():
        columns = {column["name"]: column for column in described[name]["columns"]}
        for field, size, kind in fields:
            column = columns[field]
            assert column["filter"] == f"taurus.{name}.{field}"
            assert bool(column["learnable"]) == (column["type"] == "float" and column["unit"] != "%")
            if kind is None:
                assert (column["type"], column["unit"]) == ("time", "s")
            elif model.is_float(kind):
                assert (column["type"], column["unit"], column["low"], column["high"]) == ("float", kind[2], *kind[:2])
            elif isinstance(kind, model.Number) and kind.column != "integer":
                assert column["type"] == kind.column
            else:
                width = "flags" if model.is_flags(kind) else "uint"
                assert (column["type"], column["kind"], column["bits"]) == ("integer", width, 8 * size)
                assert not isinstance(kind, set) or kind == set(map(int, column["values"]))
            for flag in kind[1].values() if model.is_flags(kind) else ():
                assert columns[f"{kind[0]}_{flag}"]["filter"] == f"taurus.{name}.{kind[0]}.{flag}"


@CHECKED
def test_csv(results, seed, form, passes):
    table = results(seed, form, passes)[1]
    names = [f"{message[0]}.csv" for message in model.MESSAGES.values()]
    assert sorted(path.name for path in table.iterdir()) == sorted(["fields.json", *names])
    described = json.loads((table / "fields.json").read_text())["messages"]
    check_fields(described)
    for kind, expected in flight_of(seed).rows(form).items():
        with open(table / f"{kind}.csv", newline="") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
        assert [column["name"] for column in described[kind]["columns"]] == reader.fieldnames
        assert len(rows) == len(expected)
        for row, truth in zip(rows, expected):
            check_row(row, *truth)


@pytest.mark.parametrize("seed", [2, 3])
def test_shared_sources(seed):
    """Where controllers share a source, that is told once, and nothing that depends on what came before: the exit code is 21."""
    flight, form = flights.shared(seed), flights.FORMS[seed % 3]
    capture = flight.write(tshark.writable_folder() / ("run.log" if form == "candump" else "run.pcapng"), form)
    taps = [word for what in ("events", "faults", "summary") for word in ("-z", f"yapp,{what},json")]
    done = tshark.run(*flight.arguments(form), "-q", "-r", capture, *taps, check=False)
    notes = re.findall(r"yapp: two controllers appear to send (?:\S+ )?(0x\w+): from frame (\d+) on", done.stderr)
    assert done.returncode == 21
    lines = [line for line in map(json.loads, done.stdout.splitlines()) if "kind" in line]
    shared = {(line["bus"], line["id"]): line["frame"] for line in lines if line["kind"] == "shared"}
    clocked = {(flight.bus_name(sender.bus, form), sender.ident) for sender, messages, is_shared in flight.sources()
               if is_shared and sender.has_clock and len(messages) > 30}
    assert clocked and clocked <= set(shared)
    assert sorted(notes) == sorted((f"{ident:#x}", str(frame)) for (_, ident), frame in shared.items())
    for line in lines:
        if line["kind"] in ("reboot", "stale", "jump", "silence", "missing") or line.get("event") in ("raised", "cleared"):
            assert line["frame"] < shared.get((line["bus"], line["id"]), 1 << 40), line
    done = tshark.run(*flight.arguments(form), "-q", "-r", capture, "-z", "yapp,check,shared=0", "-z", "yapp,faults", check=False)
    assert done.returncode == 20 and "YAPP faults: UNKNOWN, " in done.stdout


# check ---------------------------------------------------------------------------------------------------------------

def rules_of(summary, events):
    """Rules at what was really seen: (texts, tightened texts), for all sources together."""
    def seen(kind):
        counted = {}
        for line in events:
            if kind in (line["kind"], model.KINDS[line["kind"]].get("counts_as")) and line.get("event", "raised") == "raised":
                frames = counted.setdefault((line["bus"], line["id"], line["message"]), {})
                frames[line["frame"]] = line.get("count", 1)  # several of a message are one
        counts = [sum(frames.values()) for frames in counted.values()] or [0]
        return sum(counts) if model.KINDS[kind].get("scope") == "capture" else max(counts)

    rules = [(kind, seen(kind)) for kind in model.RULES]
    loose = [f"{name}={count}" for name, count in rules]
    tight = [f"{name}={count - 1}" for name, count in rules if count]
    for kind in flights.KIND:
        counts = [line["count"] for line in summary if line["message"] == kind]
        if counts:
            loose.append(f"{kind}.count={min(counts)}")
            tight.append(f"{kind}.count={min(counts) + 1}")
    return loose, tight


@pytest.mark.parametrize("seed", SEEDS)
def test_check_alone(results, seed):
    """All of what went wrong in a flight fails it, and nothing does where nothing went wrong."""
    form = flights.FORMS[seed % 3]
    capture = results(seed, form, "one pass")[2]
    found, returned = statistics(flight_of(seed), form, capture, "check,json", check=False)
    loose, tight = rules_of(flight_of(seed).truth(form)["summary"], flight_of(seed).truth(form)["events"])
    failed = {line["rule"].split("=")[0] for line in found["check"] if line["ok"] is False}
    assert returned == 20 and failed == {rule.split("=")[0] for rule in tight} - {f"{kind}.count" for kind in flights.KIND}
    clean = flights.make(seed, True)
    done = tshark.run(*["-2"] * (seed % 2), *clean.arguments(form), "-q", "-r",
                      clean.write(capture.with_name(f"{seed}.clean.{capture.name}"), form), "-z", "yapp,check", check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("seed", SEEDS)
def test_check(results, seed):
    """Each rule holds at what the truth has, and fails one step beyond."""
    form, flight = "pcapng", flight_of(seed)
    truth = flight.truth(form)
    capture = results(seed, flights.FORMS[seed % 3], "one pass")[2].with_name(f"{seed}.check.pcapng")
    flight.write(capture, form)
    summary = [line for line in truth["summary"]]
    loose, tight = rules_of(summary, truth["events"])
    for rules, code in ((loose, 0), (tight + [rule for rule in loose if rule.startswith("unknown")], 20)):
        found, returned = statistics(flight, form, capture, "check,json," + ",".join(rules), check=False)
        assert returned == code, found["check"]
        failed = {line["rule"] for line in found["check"] if line["ok"] is False}
        assert failed == (set() if code == 0 else set(tight)), found["check"]
        assert all(line["ok"] is not None for line in found["check"])


PAGE, RULES = ((tshark.ROOT / f"docs/{name}.md").read_text("utf-8") for name in ("statistics", "rules"))
KINDS, MEASURES = (published.inventory()[name] for name in ("kinds", "rules"))


def test_the_kinds_of_event_in_the_document():
    """Each rule has a row in docs/rules.md, which says so where `check` alone does not judge it.  docs/filters.md has all kinds."""
    found = re.findall(r"\w+", "".join(re.findall(r"^\|(.*?)\|", PAGE.partition("| kind | what happened |")[2].partition("\n\n")[0], re.M)))
    assert set(found) == {row["name"] for row in KINDS if not row["is_counted_only"]}, "kinds of events in docs/statistics.md"
    rows = re.search(r"\| rule \|.*?\n\n", RULES, re.S)[0].splitlines()
    rules = {rule: "not part of `check` alone" not in row for row in rows for rule in re.findall(r"`(\w+)=N`", row)}
    assert rules == {row["name"]: not row["is_optional"] for row in KINDS if not row["counts_as"]}, "a row of docs/rules.md"
    # Flights have each, but those of a capture, of copies, of streams and of shared sources, and a Command that turns motors off.
    flown = {line["kind"] for seed in range(9) for line in flight_of(seed).truth("pcapng")["events"]} | {"copies", "disabled", "shared", "skipped"}
    assert not [row["name"] for row in KINDS if row["name"] not in flown and row["scope"] != "capture"], "Sender in flights.py makes it happen"
    assert not [row["text"] for row in MEASURES if f"| `{row['text']}` | {row['help']} |" not in RULES], "run make regenerate"


def test_the_keys_of_the_document(folder):
    """In docs/statistics.md, in the row of the statistic and in no other order."""
    names = [name for name in model.STATISTICS if name != "watch"]  # it has lines of two kinds
    table = re.findall(rf"(?m)^\| `({'|'.join(names)})` \| `(.*?)`", PAGE.partition("## Keys of JSON")[2])
    rows = {name: keys.split() for name, keys in table}
    taps = [word for name in names for word in ("-z", f"yapp,{name}{f',{folder}/tables' * (name == 'csv')},json")]
    done = tshark.run("-q", "-r", tshark.ROOT / "docs/flight.pcapng", *taps, check=False)
    keys = {tuple(json.loads(line)) for line in done.stdout.splitlines()}
    found = [name for line in keys for name, first in rows.items() if line[:len(first)] == tuple(first)]
    assert len(found) == len(keys) and set(found) == set(names), f"rows of docs/statistics.md, Keys of JSON: {set(names) ^ set(found)}"
