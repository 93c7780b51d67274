#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Measures the plugin beside its peers and writes docs/BENCH.md: make bench, make bench RUNS=5 BASE=folder

Each work is done by each of its peers in turns, RUNS times, on this machine's tshark and on that of each chroot of tests/matrix.
What counts is the median of the CPU time of the whole process, user and system; memory is the most it had.

    none    tshark without the plugin
    hand    tests/bench/by_hand.lua: a Lua dissector for this one message and nothing besides
    script  tests/bench/peer.py: python-can and a decoder by hand
    base    another version of the plugin, a checkout
    list    the plugin's packet list of the same messages
"""
import argparse
import collections
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
TOP = HERE.parents[1]
sys.path[:0] = [str(HERE), str(TOP / "tests/e2e")]
import traffic  # noqa: E402
import tshark  # noqa: E402

CHROOTS = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "yapp-matrix"
MOTOR = ("torque_iq_commanded torque_iq_measured rpm_commanded rpm_measured dc_voltage dc_current motor_temperature motor_mode "
         "status_flags fault_flags timestamp motor_state esc_temperature").split()
VALUES = ["-T", "fields", *(word for name in MOTOR for word in ("-e", f"taurus.motor.{name}"))]
FAULT = ["-Y", "taurus.motor.fault.motor_overcurrent"]
Work = collections.namedtuple("Work", "title capture options peer goal", defaults=("none", None))
WORKS = [
    Work("packet list", "yapp.pcap", [], "hand", 1.2),
    Work("one fault filter", "yapp.pcap", FAULT, "hand", 1.35),
    Work("`-V`", "yapp.pcap", ["-V"], "hand", 1.2),
    Work("`-T fields`, 13 values", "yapp.pcap", VALUES, "hand", 1.25),
    Work("`-z yapp,csv` of a log", "yapp.log", ["-q", "-z", "yapp,csv,-,motor"], "script", 2.0),
    Work("`-z yapp,summary`", "yapp.pcap", ["-q", "-z", "yapp,summary"]),
    Work("`-z yapp,check`", "yapp.pcap", ["-q", "-z", "yapp,check,crc=0"]),
    Work("UART, 64 bytes a packet", "uart.pcap", [], "list", 0.8),
    Work("candump log", "yapp.log", []),
    Work("two interfaces", "two_buses.pcapng", [], "list", 1.1),
    Work("two passes, `-2`", "yapp.pcap", ["-2"]),
    Work("2,000 unknown IDs", "unknown.pcap", ["-o", "yapp.all_extended:TRUE"], "few", 1.3),
    Work("foreign CAN", "isotp.pcap", [], "none", 1.04),
    Work("foreign UDP", "udp.pcap", [], "none", 1.02),
    Work("start: one frame", "one.pcap", [], "none", 1.08),
]


class Tshark:
    """One tshark: this machine's, or a chroot's."""

    def __init__(self, root, folder):
        if root:
            shutil.rmtree(root / "tmp/yapp-bench", ignore_errors=True)
            shutil.copytree(folder, root / "tmp/yapp-bench")
            self.prefix = ["chroot", str(root), "setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"]
        else:
            self.prefix = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"] if os.geteuid() == 0 else []
        self.folder, self.here = pathlib.Path("/tmp/yapp-bench") if root else folder, folder  # seen by tshark, and by the script
        says = subprocess.run([*self.prefix, "tshark", "--version"], capture_output=True, text=True, check=True).stdout
        self.version = re.search(r"\(Wireshark\) ([\d.]*\d)", says)[1]

    def command(self, work, peer):
        """The command line of a peer."""
        if peer == "script":
            return ["/usr/bin/python3", HERE / "peer.py", self.here / "yapp.log", self.here / "script.csv"]
        capture, options, script = work.capture, work.options, []
        if peer == "list":
            capture = "yapp.pcap"
        elif peer == "few":
            capture = "few_unknown.pcap"
        if peer == "hand":
            script = ["-X", f"lua_script:{self.folder / 'by_hand.lua'}", "-X", "lua_script1:run"]
            options = [word.replace("taurus.motor.", "by_hand.") for word in options]
        elif peer != "none":
            script = ["-X", f"lua_script:{self.folder / ('base' if peer == 'base' else 'now') / 'yapp.lua'}"]
        else:
            options = [word for word in options if word in ("-V", "-2")]
        return [*self.prefix, "tshark", *script, "-r", self.folder / capture, *options]


def measure(command):
    """(CPU seconds, most bytes) of one run; raises where it fails or Lua does."""
    process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL,
                               env={"PATH": "/usr/sbin:/usr/bin:/bin", "HOME": "/nonexistent", "LC_ALL": "C.UTF-8", "TZ": "UTC"})
    said = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0 and "Lua" not in said, f"{command}: {process.returncode} {said}"
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024


def measure_work(shark, work, peers, runs):
    """Medians of a work: { peer: (CPU seconds, bytes) }; ratios of paired runs: { peer: now by the peer's }."""
    found = {peer: [] for peer in peers}
    for _ in range(runs):
        for peer in peers:
            found[peer].append(measure(shark.command(work, peer)))
    medians = {peer: tuple(map(statistics.median, zip(*rows))) for peer, rows in found.items()}
    ratios = {peer: statistics.median(now[0] / other[0] for now, other in zip(found["now"], rows)) for peer, rows in found.items()}
    return medians, ratios


def table(shark, works, has_base, runs):
    """The lines of one version."""
    base = " now / base |" if has_base else ""
    yield f"\n## Wireshark {shark.version}\n\n| work | now, s | MB | of the peer |{base} goal |\n|---|---|---|---|{'---|' if has_base else ''}---|\n"
    for work in works:
        peers = list(dict.fromkeys(["now", work.peer, *(["base"] if has_base else [])]))
        medians, ratios = measure_work(shark, work, peers, runs * (3 if "start" in work.title else 1))
        cells = [work.title, f"{medians['now'][0]:.2f}", f"{medians['now'][1] / 1e6:.0f}", f"{ratios[work.peer]:.2f} of {work.peer}"]
        cells += [f"{ratios['base']:.2f}"] if has_base else []
        goal = "" if not work.goal else f"{work.goal:g}" + ("" if ratios[work.peer] <= work.goal else ", missed")
        yield f"| {' | '.join([*cells, goal])} |\n"


def prepare(folder, messages, plugins):
    """The captures, the dissector by hand, and the plugins: { name: folder of its tree }."""
    traffic.make(folder, messages)
    for name, count in (("unknown.pcap", 2000), ("few_unknown.pcap", 8)):
        traffic.write_pcap(folder / name, traffic.SOCKETCAN, traffic.unknown_packets(messages, count))
    shutil.copy(HERE / "by_hand.lua", folder)
    for name, plugin in plugins.items():
        tshark.copy_plugin(folder / name, plugin)
    tshark.copy_plugin(folder, plugins["now"])  # by_hand.lua takes the CRC and the catalogue of it
    subprocess.run(["chmod", "-R", "a+rwX", folder], check=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3, help="how often each command is run")
    parser.add_argument("--base", type=pathlib.Path, help="a checkout of another version")
    parser.add_argument("--messages", type=int, default=20_000)
    parser.add_argument("--only", default="", metavar="WORD", help="works with this in their title; writes no file")
    parser.add_argument("--suite", action="append", help="here, trixie or sid; all that are there by default")
    options = parser.parse_args()
    folder = tshark.writable_folder()
    works = [work for work in WORKS if options.only in work.title]
    says = ["# How fast it is\n\n", "Written by `make bench`: medians of whole processes, in turns with their peers, see\n`tests/bench/bench.py`. "
            f"{options.messages:,} messages of five frames, {os.cpu_count()} cores, {options.runs} runs.\n"]
    try:
        prepare(folder, options.messages, {"now": TOP, **({"base": options.base} if options.base else {})})
        for suite in options.suite or ["here", "sid"]:
            root = None if suite == "here" else CHROOTS / suite
            if root and not (root.exists() and os.geteuid() == 0):
                print(f"bench: {suite} is left out: tests/matrix makes its chroot, as root")
                continue
            for line in table(Tshark(root, folder), works, bool(options.base), options.runs):
                print(line, end="", flush=True)
                says.append(line)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    if not options.only and not options.suite:
        (TOP / "docs/BENCH.md").write_text("".join(says), encoding="utf-8")


if __name__ == "__main__":
    main()
