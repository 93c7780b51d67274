#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Ten captures under valgrind: no error in memory with Lua in its stack.

Wireshark and GLib allocate each block by itself, so that valgrind sees the end of each.  What has no Lua in its stack is
Wireshark's own: it is counted, and is no failure.  A fault that is planted first has to be seen.
"""
import os
import pathlib
import subprocess
import sys
import xml.etree.ElementTree

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import tshark  # noqa: E402

CAPTURES = {  # what it is of: the file and how it is decoded
    "CAN": ["can/document_motor.pcap"],
    "CAN FD": ["can/fd_multi_frame.pcap"],
    "serial, split": ["serial/document_uart_split.pcap"],
    "TCP, split": ["serial/document_tcp_split.pcap", "-d", "tcp.port==20001,yapp_serial"],
    "UDP": ["serial/document_udp.pcap"],
    "RTAC": ["serial/document_uart_rtac.pcap", "-d", "rtacser.data,yapp_serial"],
    "candump -L": ["candump/candump_log_two_buses.log"],
    "ASC": ["other/motor.asc"],
    "dump": ["serial/dump_document.yapp"],
    "a finding of the fuzzer": ["fuzz/tcp_notes_without_bytes.pcapng", "-d", "tcp.port==20001,yapp_serial"],
}
WAY = ["-2", "-V", "-z", "yapp,summary", "-z", "yapp,events", "-z", "expert"]
ALONE = {"WIRESHARK_DEBUG_WMEM_OVERRIDE": "simple", "G_SLICE": "always-malloc"}
# A coroutine gives back memory that Lua still has.
PLANTED = 'coroutine.wrap(package.loadlib("libc.so.6", "free"))()'


def errors(folder, capture, *arguments):
    """What valgrind says of a run: [(error, its stack as text, innermost function first)]."""
    report = folder / "valgrind.xml"
    words = ["valgrind", "--quiet", "--num-callers=100", "--xml=yes", f"--xml-file={report}", "tshark",
             *arguments, "-r", tshark.CAPTURES / capture[0], *capture[1:], *WAY]
    done = subprocess.run(list(map(str, words)), env={**os.environ, **ALONE, "HOME": str(tshark.home(False))},
                          stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, **tshark._user())
    found = []
    for error in xml.etree.ElementTree.parse(report).iter("error"):
        frames = [f"{one.findtext('fn') or '?'} ({os.path.basename(one.findtext('obj') or '?')})"
                  for one in error.find("stack").iter("frame")]
        # A leak: what Wireshark allocates once as it loads a script, and leaves to the end of the program.
        if error.findtext("kind").startswith("Leak_") and any(one.startswith("epan_init ") for one in frames):
            continue
        found.append((error.findtext("what") or error.findtext("xwhat/text"), " < ".join(frames)))
    assert found or done.returncode == 0 and "Lua" not in done.stderr and "YAPP" in done.stdout, f"{capture}: {done.stderr}"
    return found


def main():
    folder, bad = tshark.writable_folder(), 0
    (folder / "planted.lua").write_text(PLANTED)
    if not any("liblua" in stack for _, stack in errors(folder, CAPTURES["UDP"], "-X", f"lua_script:{folder / 'planted.lua'}")):
        sys.exit("valgrind: what is planted is not seen")
    for name, capture in CAPTURES.items():
        found = errors(folder, capture, *tshark.load())
        ours = [one for one in found if "liblua" in one[1]]
        bad += bool(ours)
        print(f"{name}, {capture[0]}: {len(ours)} errors with Lua in the stack, {len(found) - len(ours)} others", flush=True)
        for what, stack in ours:
            print(f"  {what}\n    {stack}")
    print(f"{len(CAPTURES) - bad} passed, {bad} failed")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
