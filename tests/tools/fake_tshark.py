#!/usr/bin/env python3
"""A stand-in for tshark with the plugin, for what the real one does not do on demand: it crashes, refuses, hangs.

Its captures are JSON: {"motor": [row, ...], "events": [...], "summary": [...], "does": [what the 1st, 2nd, ... run
does]}; a row is {column: text}.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

HEAD = ["time", "frame", "bus", "source", "id", "seq"]
MOTOR = [
    {"name": "rpm_measured", "title": "Measured speed", "kind": "float16", "unit": "RPM", "filter": "taurus.motor.rpm"},
    {"name": "motor_mode", "title": "Motor mode", "kind": "uint8", "values": {"0": "Torque Mode", "1": "Speed Mode"}},
    {"name": "fault_flags", "title": "Fault flags", "kind": "uint32", "group": "fault",
     "flags": [{"name": "motor_overcurrent", "mask": 65536, "title": "Motor overcurrent"}]},
    {"name": "timestamp", "title": "Time", "kind": "int64_ns", "unit": "s"},
    {"name": "serial", "title": "Serial number", "kind": "uint64"},
]  # fmt: skip
FIELDS = {
    "version": os.environ.get("FAKE_VERSION", "1.0"),
    "messages": {
        "motor": {"title": "Motor Data", "id": 0x210, "every": 0.1, "fields": MOTOR},
        "note": {"title": "Note", "id": 0x300, "fields": [{"name": "text", "title": "Text", "kind": "string"}]},
    },
}
COLUMNS = {
    "motor": ["rpm_measured", "rpm_measured_special", "motor_mode", "motor_mode_text", "fault_flags",
              "fault_motor_overcurrent", "timestamp", "serial"],
    "note": ["text"],
}  # fmt: skip


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
    flight = json.loads(content) if content.startswith(b"{") else {}
    code = behave(capture, flight.get("does", []))
    for name, what, *rest in wanted:
        assert name == "yapp", name
        if what == "csv":
            write(Path(rest[0]), flight)
        else:
            assert rest[0] == "json", rest
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
        case "sleep":
            time.sleep(600)
    return 0


def write(folder, flight):
    folder.mkdir()
    (folder / "fields.json").write_text(json.dumps(FIELDS))
    for message, columns in COLUMNS.items():
        if rows := flight.get(message):
            lines = [",".join(row.get(name, "") for name in HEAD + columns) for row in rows]
            (folder / f"{message}.csv").write_text("\n".join([",".join(HEAD + columns), *lines, ""]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
