#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""make changes: six changes, each made in a scratch clone as CONTRIBUTING.md's table says, with what its user sees, and the tests.

A change is a list of edits (file, the text in front of it, the new text), a capture, a command of tshark, and what it prints.
make regenerate follows (less the pages of yapp-tables), then tests run that use every row.  A text that is not there any more:
edit the change here, and the row of the table.
"""
import os
import pathlib
import re
import shutil
import struct
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests/e2e"), str(ROOT / "test_captures")]
import make  # noqa: E402

MESSAGE = """\
  {
    name = "battery",
    title = "Battery",
    id = 0x340,
    size = 28,
    every = 0.25,
    info = "{level:%.0f unit}",
    { "clock", "int64_ns", "Clock" },
    { "level", "float16", "Level", min = 0, max = 100, unit = "%" },
    { "mode", "uint8", "Mode", values = { [0] = "Idle", [1] = "Charging" } },
    { "alarms", "uint8", "Alarms", group = "alarm", alarm = true,
      flags = { { "hot", 0x1, "Hot" }, { "cold", 0x2, "Cold" } } },
    { "charge", "float64", "Charge", unit = "Ah" },
    { "maker", "string", "Maker", length = 8 },
  },
"""
MODEL = """\
    0x340: Message("battery", "Battery", [
        ("clock", 8, None), ("level", 2, (0, 100, "%")), ("mode", 1, {0, 1}),
        ("alarms", 1, Flags("alarm", {0x1: "hot", 0x2: "cold"}, 0xFF)), ("charge", 8, REAL), ("maker", 8, TEXT)], 0.25),
"""
RULE = """\
  {
    "most",
    "MESSAGE.most=N",
    "at most N messages came",
    measure = function(group) return group.count, group.last and group.last.frame end,
    is_count = true,
  },
"""
FORM = """\
  { -- can0|08404000|BBBE6FC720000000
    pattern = "^(%S+)|(%x+)|(%x*)$",
    read = function(log, bus, id, data) return read_log(log, bus, id, data, "", "") end,
    like = "|%x+|",
  },
"""
MOTOR = "FD7FFD7FFD7FFD7FF5AFFD7F18010000014000000100E38CD23CE04E00000550"
BATTERY = f"can0 [340 {'00' * 8} F57F 01 01 {'00' * 6}F03F {'41' * 8}]\n"
SCTP = ["-d", "sctp.port==40,yapp_serial", "-T", "fields", "-e", "taurus.motor.dc_voltage"]


def can(folder, text=f"can0 fd [210 {MOTOR}]\n"):
    path = folder / "run.pcap"
    path.write_bytes(make.pcap(make.Source(text)))
    return path


def battery(folder):
    return can(folder, BATTERY)


def bars(folder):
    frames = make.can_frames({"id": 0x210, "payload": bytes.fromhex(MOTOR), "seq": 0, "ctl": 0, "wrong_crc": False}, False)
    path = folder / "run.log"
    path.write_text("".join(f"(1700000000.{at:06d}) can0|{ident:08X}|{data.hex()}\n" for at, (ident, data) in enumerate(frames)))
    return path


def sctp(folder):
    """A frame in a DATA chunk: SCTP's header, ports 30 and 40."""
    data = b"YP" + struct.pack("<BBIHH", 0, 0, 0x210, 32, 0) + bytes.fromhex(MOTOR)
    data += make.crc32k(data).to_bytes(4, "little")
    chunk = struct.pack(">HHIIBBHIHHI", 30, 40, 0, 0, 0, 3, 16 + len(data), 1, 0, 0, 0) + data
    packet = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(chunk), 1, 0, 64, 132, 0, b"\n\0\0\1", b"\n\0\0\2") + chunk
    path = folder / "run.pcap"
    path.write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101) +
                     struct.pack("<IIII", 1, 0, len(packet), len(packet)) + packet)
    return path


# Name, edits, capture, arguments of tshark, exit code, what is printed.
CHANGES = [
    ("a message", [("taurus_fields.lua", '    { "board_revision", "uint8", "Board Revision" },\n  },\n', MESSAGE),
                   ("tests/e2e/model.py", '("board_revision", 1, Number())], 0.5),\n', MODEL)],
     battery, ["-q", "-z", "yapp,faults"], 0, r"Battery +alarms +hot +raised"),
    ("a value from two fields", [("taurus_fields.lua", "derived = {", '\n      { "heat", "motor_temperature - esc_temperature", "Heat", unit = "K" },\n     ')],
     can, ["-O", "taurus"], 0, r"Heat: "),
    ("a rule", [("yapp/stat/rules.lua", "M.OF_MESSAGE = input.rows(\"name text help\", {\n", RULE)],
     can, ["-q", "-z", "yapp,check,motor.most=0"], 20, r"FAILED +motor.most=0"),
    ("a column", [("yapp/stat/lists.lua", "what the catalogue says of the flag\" },\n",
                   '  { "minute", "integer", "minutes since the first packet" },\n'),
                  ("yapp/stat/lists.lua", "    rel = output.seconds(time),\n", "    minute = time and math.floor(time / 60),\n")],
     can, ["-q", "-z", "yapp,faults,json"], 0, r'"minute":0'),
    ("a form of a log", [("yapp/file/candump.lua", "local FORMS = {\n", FORM)],
     bars, ["-Y", "taurus.motor"], 0, r"Motor Data"),
    ("a way in", [("yapp.lua", '  ["udp.port"] = serial,\n', '  ["sctp.port"] = serial,\n')],
     sctp, SCTP, 0, r"47\.97314"),
]
# What uses every message, value, rule, column, form and way in.
TESTS = ["tests/e2e/test_published.py", "tests/e2e/test_arrows.py", "tests/e2e/test_flight_fields.py", "tests/e2e/test_statistics.py",
         "tests/e2e/test_captures.py", "tests/e2e/test_candump.py", "tests/e2e/test_readme.py", "-k",
         "not page_of_columns and (published or inventory or vendors or row_says or picture or test_fields or worked_out or test_events or test_faults or test_summary "
         "or test_csv or of_the_document or in_the_document or each_flag_and or unknown_id_is_like or rounded or test_form or page_of_filters)"]


def run(*command, cwd, code=0, **options):
    done = subprocess.run(list(map(str, command)), cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False, **options)
    assert done.returncode == code, f"{' '.join(map(str, command))}\n{done.stdout[-4000:]}"
    return done.stdout


def main():
    with tempfile.TemporaryDirectory(prefix="yapp-changes-") as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)  # as root, some programs run as nobody
        clone = folder / "clone"
        shutil.copytree(ROOT, clone, ignore=shutil.ignore_patterns(".git", "dist", "node_modules", "__pycache__"))
        (folder / "home").mkdir()
        environment = {**os.environ, "HOME": str(folder / "home"), "LC_ALL": "C.UTF-8", "TZ": "UTC"}
        for title, edits, *_ in CHANGES:
            for path, before, text in edits:
                whole = (clone / path).read_text(encoding="utf-8")
                assert whole.count(before) == 1, f"{title}: {path} has {whole.count(before)} times {before!r}"
                (clone / path).write_text(whole.replace(before, before + text), encoding="utf-8")
        for title, _, capture, arguments, code, printed in CHANGES:
            shown = run("tshark", "-X", "lua_script:yapp.lua", "-r", capture(folder), *arguments, cwd=clone, code=code, env=environment)
            assert re.search(printed, shown), f"{title}: {shown[-1000:]}"
            print(f"changes: {title}", flush=True)
        print(run(sys.executable, "tools/regenerate.py", "--without-tables", cwd=clone, env=environment), end="", flush=True)
        print(run("luacheck", "-q", ".", cwd=clone).splitlines()[-1])
        print(run("pytest-3", "-q", "-x", "-n", os.cpu_count(), "-p", "no:cacheprovider", *TESTS, cwd=clone, env=environment).splitlines()[-1])


if __name__ == "__main__":
    main()
