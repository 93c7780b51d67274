#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""A stand-in for tshark with the plugin, for what the real one does not do on demand: it crashes, refuses, hangs.

Its captures are JSON: {"motor": [row, ...], "events": [...], "summary": [...], "does": [what the 1st, 2nd, ... run
does], "says": on stderr}; a row is {column: text}.
"""

import itertools
import json
import os
import signal
import sys
import time
from pathlib import Path

HEAD = ["time", "frame", "bus", "source", "id", "seq"]
COLUMNS = {
    "motor": [
        {"name": "rpm_measured", "type": "float", "unit": "RPM", "title": "Measured speed",
         "filter": "taurus.motor.rpm"},
        {"name": "rpm_measured_special", "type": "string"},
        {"name": "motor_mode", "type": "integer", "title": "Motor mode", "kind": "uint", "bits": 8,
         "values": {"0": "Torque Mode", "1": "Speed Mode"}},
        {"name": "motor_mode_text", "type": "string"},
        {"name": "fault_flags", "type": "integer", "kind": "flags", "bits": 32},
        {"name": "fault_motor_overcurrent", "type": "bool", "title": "Motor overcurrent"},
        {"name": "timestamp", "type": "time", "unit": "s"},
        {"name": "serial", "type": "integer", "kind": "uint", "bits": 64},
        {"name": "revision", "type": "integer", "kind": "uint", "bits": 8},
    ],
    "note": [{"name": "text", "type": "string"}],
}  # fmt: skip
if "FAKE_COLUMN" in os.environ:  # a catalogue that has another field
    COLUMNS["motor"].append(json.loads(os.environ["FAKE_COLUMN"]))
WHO = "bus string, id id, source string, message string"
STATISTICS = {
    "events": f"kind string, time time, frame integer, {WHO}, field string, flag string, event string, active seconds, "
    "length seconds, what string, value text, size integer, count integer, like string, help string",
    "faults": f"time time, frame integer, {WHO}, field string, flag string, event string, active seconds, help string",
    "summary": f"{WHO}, count integer, rate number, gap_min seconds, gap_mean seconds, gap_max seconds, "
    "gap_max_frame integer, crc_bad integer, incomplete integer, late integer, reboots integer, values values, "
    "invalid integer, missing integer, copies integer",
    "buses": "bus string, frames integer, rate number, yapp integer, errors values, load number, load_max number",
}


def described(text):
    """The columns "name type, name type" as fields.json has them."""
    pairs = [pair.split() for pair in text.split(", ")]
    return {"columns": [{"name": name, "type": type_, "unit": None, "title": name} for name, type_ in pairs]}


FIELDS = {
    "version": 1,
    "statistics": {name: described(text) for name, text in STATISTICS.items()},
    "plugin": os.environ.get("FAKE_VERSION", "1.0"),
    "messages": {
        "motor": {"title": "Motor Data", "every": 0.1, "columns": COLUMNS["motor"]},
        "note": {"title": "Note", "columns": COLUMNS["note"]},
    },
}


def main(arguments):
    if arguments == ["--version"]:
        print(f"TShark (Wireshark) {os.environ.get('FAKE_WIRESHARK', '4.0.17')}")
        return 0
    capture = Path(arguments[arguments.index("-r") + 1])
    wanted = [arguments[at + 1].split(",") for at, word in enumerate(arguments) if word == "-z"]
    content = capture.read_bytes()
    if os.environ.get("FAKE_PLUGIN") == "none":
        print(f'tshark: Invalid -z argument "{",".join(wanted[0])}"; it must be one of:', file=sys.stderr)
        return 1
    given = [[b for a, b in itertools.pairwise(arguments) if a == f"-{name}"] for name in "oC"]
    asked = {"o": given[0], "C": next(iter(given[1]), None), "messages": os.environ.get("YAPP_MESSAGES")}
    if wanted:
        with capture.with_suffix(".asked").open("a") as file:
            file.write(json.dumps(asked) + "\n")
    flight = json.loads(content) if content.startswith(b"{") else {}
    print(flight.get("says", ""), file=sys.stderr)
    code = behave(capture, flight.get("does", []))
    for name, what, *rest in wanted:
        assert name == "yapp", name
        if what == "csv":
            write(Path(rest[0]), flight)
        elif what != "fault":  # of which it knows nothing
            assert rest[-1] == "json", rest
            for record in flight.get(what, []):
                print(json.dumps(record))
    return code


def behave(capture, does):
    tries = capture.with_suffix(".tries")
    number = len(tries.read_text()) if tries.exists() else 0
    with tries.open("a") as file:
        file.write(".")
    match does[number] if number < len(does) else "":
        case "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "cut":
            print(
                f'tshark: The file "{capture}" appears to have been cut short in the middle of a packet.',
                file=sys.stderr,
            )
            return 2
        case "refuse":
            print(
                f'tshark: The file "{capture}" isn\'t a capture file in a format TShark understands.', file=sys.stderr
            )
            sys.exit(2)
        case "nap":
            time.sleep(0.3)
            wait_while_held(capture.parent)
    return 0


def wait_while_held(folder):
    """Hold a run, if ten captures were begun, until the file "hold" is gone: a test kills before all is done."""
    until = time.monotonic() + 60
    while (folder / "hold").exists() and len(list(folder.glob("*.tries"))) > 10 and time.monotonic() < until:
        time.sleep(0.05)


def write(folder, flight):
    folder.mkdir(exist_ok=True)
    (folder / "fields.json").write_text(json.dumps(FIELDS))
    for message, columns in COLUMNS.items():
        header = HEAD + [column["name"] for column in columns]
        lines = [",".join(row.get(name, "") for name in header) for row in flight.get(message, [])]
        (folder / f"{message}.csv").write_text("\n".join([",".join(header), *lines, ""]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
