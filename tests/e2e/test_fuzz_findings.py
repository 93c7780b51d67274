# SPDX-License-Identifier: GPL-2.0-or-later
"""What `make fuzz` found stays found: test_captures/fuzz/, each with the arguments it failed with; and the fuzzer sees
what goes wrong, tried with faults planted into copies of the plugin."""
import importlib
import shlex
import shutil
import subprocess
import sys

import levels
import pytest
import tshark

sys.path.insert(0, str(tshark.ROOT / "tests"))
fuzz = importlib.import_module("fuzz")


def short(way):
    return shlex.join(way)[:30]


FINDINGS = sorted(path for path in (tshark.CAPTURES / "fuzz").iterdir() if path.suffix != ".args")


@pytest.mark.parametrize("path", FINDINGS, ids=lambda path: path.stem)
def test_finding(path):
    """As it was found; in test-all in every principal way too."""
    assert list(fuzz.replay(path, levels.size(fuzz.AS_FOUND, fuzz.EVERY_WAY))) == []


# The detectors -----------------------------------------------------------------------------------------------------

def plant(folder, file, behind, line):
    """A copy of the plugin with a line of Lua behind a line of its own."""
    tshark.copy_plugin(folder, tshark.ROOT)
    lines = (folder / file).read_text().splitlines()
    at = next(at for at, text in enumerate(lines) if text.startswith(behind))
    (folder / file).write_text("\n".join([*lines[:at + 1], line, *lines[at + 1:]]))


@pytest.fixture
def planted(folder, monkeypatch):
    """planted(file, line behind which, line of Lua, capture, way) says what the fuzzer says."""
    homes = []

    def look(file, behind, line, name, way, installed=False):
        plant(folder, file, behind, line)
        monkeypatch.setattr(fuzz, "PLUGIN", folder)
        fuzz.homes.cache_clear()
        homes.append(fuzz.homes())
        path = tshark.CAPTURES / name
        return fuzz.show_file(fuzz.Capture(path.suffix, b"", [path.read_bytes()], []), way, folder, installed).problem

    yield look
    fuzz.homes.cache_clear()
    for home in homes:
        shutil.rmtree(home, ignore_errors=True)


LOADED = ("yapp.lua", "local VERSION")
DISSECTOR = ("yapp/serial/framer.lua", "function Framer:add(")
READER = ("yapp/reading/reading.lua", "function Reading:read_message(")
INIT = ("yapp.lua", "function yapp.init")
SERIAL = ("yapp.lua", "serial.dissector = counted(function")
# A protocol of its own, in the packets of which Wireshark finds a fault that is not said to be ours.
OTHER = """local other = Proto("other", "Other") other.fields = { ProtoField.uint8("other.one", "One") }
function other.dissector(buffer, _, tree) %s end register_postdissector(other)""".replace("\n", " ")


def test_there_is_something_to_plant_behind():
    """`make test` notices a renamed function, not only the deep tests that plant."""
    for file, behind in {row[:2] for row in (*PLANTED.values(), DISSECTOR, READER, SERIAL)}:
        lines = (tshark.ROOT / file).read_text().splitlines()
        assert sum(line.startswith(behind) for line in lines) == 1, behind


@levels.deep
@levels.by_version
@pytest.mark.parametrize("installed", [False, True], ids=["script", "plugin"])
@pytest.mark.parametrize("way", fuzz.WAYS, ids=short)
def test_every_way_sees_an_error(planted, way, installed):
    if way[0] == "sharkd" and not shutil.which("sharkd"):
        pytest.skip("sharkd is not installed")
    assert "planted" in (planted(*DISSECTOR, 'error("planted")', "serial/document_udp.pcap", way, installed) or "nothing")


@levels.deep
@pytest.mark.parametrize("way", [fuzz.TWO_PASSES, ("-2", "-V"), ("sharkd",)], ids=short)
def test_an_error_of_the_first_pass_alone_is_seen(planted, way):
    if way[0] == "sharkd" and not shutil.which("sharkd"):
        pytest.skip("sharkd is not installed")
    line = 'if not pinfo.visited then error("planted") end'
    assert "planted" in (planted(*SERIAL, line, "serial/document_uart.pcap", way) or "nothing")


# What is planted, into which capture's decoding, and what the fuzzer is to say; limits are lower, to see them soon.
PLANTED = {
    "reader": ("yapp/file/readers.lua", "local function fill", 'error("planted")', "candump/candump_log2long.txt",
               "FileHandler"),
    "dump reader": ("yapp/file/readers.lua", "local function fill", 'error("planted")',
                    "fuzz/dump_of_another_size.yapp", "FileHandler"),
    "load": ("yapp/wire/frame.lua", "local M", 'error("planted")', "serial/document_udp.pcap", "Lua:"),
    "init": (*INIT, 'error("planted")', "serial/document_udp.pcap", "planted"),
    "exit": (*INIT, "os.exit(7)", "serial/document_udp.pcap", "exit code 7"),
    "crash": (*INIT, 'os.execute("kill -SEGV $PPID")', "serial/document_udp.pcap", "crash: signal 11"),
    "abort": (*INIT, 'os.execute("kill -ABRT $PPID")', "serial/document_udp.pcap", "crash: signal 6"),
    "too many items": (*LOADED, OTHER % "for _ = 1, 1.1e6 do tree:add(other.fields[1], buffer(0, 1)) end", "serial/document_udp.pcap",
                       "crash: signal 6"),
    "memory": (*INIT, 'planted = ("x"):rep(2^29)', "serial/document_udp.pcap", "memory"),
    "busy": (*DISSECTOR, "while true do end", "serial/document_udp.pcap", "hang"),
    "asleep": (*INIT, 'os.execute("sleep 20")', "serial/document_udp.pcap", "hang"),
}


@levels.deep
@pytest.mark.parametrize("way", [fuzz.TREE, fuzz.TWO_PASSES], ids=short)
@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_found(planted, monkeypatch, name, way):
    monkeypatch.setattr(fuzz, "CPU_SECONDS", 2 if name == "busy" else 20)
    monkeypatch.setattr(fuzz, "SECONDS", 3 if name == "asleep" else 120)
    *where, says = PLANTED[name]
    assert says in (planted(*where, way) or "nothing")


@levels.deep
def test_a_fault_ends_a_run_with_a_small_capture(folder):
    """The whole program: a finding is told, made small, kept; the exit code says so; kept, it is found again."""
    (folder / "plugin").mkdir()
    (folder / "kept").mkdir()
    plant(folder / "plugin", *READER, 'error("planted")')
    command = [sys.executable, tshark.ROOT / "tests/fuzz.py", "--plugin", folder / "plugin"]
    done = subprocess.run([*command, "--frames", "3000", "--jobs", "1", "--keep", folder / "kept"], capture_output=True,
                          text=True, check=False)
    assert done.returncode == 1 and "planted" in done.stdout, done.stdout + done.stderr
    kept = sorted(path for path in (folder / "kept").iterdir() if path.suffix != ".args")
    assert kept and all(path.stat().st_size < 2000 for path in kept), [path.stat().st_size for path in kept]
    done = subprocess.run([*command, "--replay", kept[0]], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "planted" in done.stdout, done.stdout + done.stderr
    done = subprocess.run([*command[:2], "--replay", kept[0]], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


# Checked memory ----------------------------------------------------------------------------------------------------

# What a process of the fuzzer's is to have: Wireshark reads the variables itself, glibc's library has to be there.
CHECKED = """local file = io.open("/proc/self/maps") local maps = file:read("*a") file:close()
if not maps:find("malloc_debug") or os.getenv("MALLOC_CHECK_") ~= "3" or
os.getenv("WIRESHARK_DEBUG_WMEM_OVERRIDE") ~= "strict" then error("not checked") end""".replace("\n", " ")


@pytest.mark.parametrize("setting", ["strict", "block"])
@pytest.mark.parametrize("way", [fuzz.TREE, ("sharkd",)], ids=short)
def test_memory_is_checked(planted, way, setting):
    if way[0] == "sharkd" and not shutil.which("sharkd"):
        pytest.skip("sharkd is not installed")
    problem = planted(*INIT, CHECKED.replace("strict", setting), "serial/document_udp.pcap", way)
    assert problem is None if setting == "strict" else "not checked" in problem
