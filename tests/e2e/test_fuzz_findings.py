"""What `make fuzz` found stays found: test_captures/fuzz_*, each with the arguments it failed with; and the fuzzer sees
what goes wrong, tried with faults planted into copies of the plugin."""
import importlib
import shutil
import subprocess
import sys

import pytest
import tshark

sys.path.insert(0, str(tshark.ROOT / "tests"))
fuzz = importlib.import_module("fuzz")

FINDINGS = sorted(path for path in tshark.CAPTURES.glob("fuzz_*") if path.suffix != ".args")

# A line of Lua behind a line of the plugin, a capture that meets it, what the fuzzer is to say.
PLANTED = {
    "dissector": ("yapp/yapp_stream.lua", "function Stream:feed", 'error("planted")', "document_udp.pcap", "planted"),
    "reader": ("yapp/yapp_candump_reader.lua", "local function fill", 'error("planted")', "candump_log2long.txt",
               "FileHandler"),
    "load": ("yapp/yapp_crc.lua", "local M", 'error("planted")', "document_udp.pcap", "Lua:"),
    "memory": ("yapp.lua", "function yapp.init", 'planted = ("x"):rep(2^28)', "document_udp.pcap", "memory"),
    "crash": ("yapp.lua", "function yapp.init", "os.exit(7)", "document_udp.pcap", "exit code 7"),
}


@pytest.mark.parametrize("path", FINDINGS, ids=lambda path: path.stem)
def test_finding(path):
    assert list(fuzz.replay(path)) == []


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_found(name, folder):
    file, behind, line, capture, says = PLANTED[name]
    for one in tshark.PLUGIN_FILES:
        source = tshark.ROOT / one
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / one)
    lines = (folder / file).read_text().splitlines()
    at = next(at for at, text in enumerate(lines) if text.startswith(behind))
    (folder / file).write_text("\n".join([*lines[:at + 1], line, *lines[at + 1:]]))
    done = subprocess.run([sys.executable, tshark.ROOT / "tests/fuzz.py", "--plugin", folder, "--replay",
                           tshark.CAPTURES / capture], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and says in done.stdout, done.stdout + done.stderr
