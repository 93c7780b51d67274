#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Measures the plugin beside its peers and writes docs/BENCH.md: make bench, make bench RUNS=5 LONG=1 BASE=folder

Each work of works.py is done by each of its peers in turns, RUNS times; what counts is the CPU time of the whole process,
user and system, and the most memory it had.  A peer that cannot be had is a row that says so, never a failure.
"""
import argparse
import contextlib
import datetime
import os
import pathlib
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import threading

HERE = pathlib.Path(__file__).resolve().parent
TOP = HERE.parents[1]
sys.path[:0] = [str(HERE), str(TOP / "tests/e2e")]
import report  # noqa: E402
import traffic  # noqa: E402
import tshark  # noqa: E402
import works  # noqa: E402

CACHE = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache") / "yapp-bench"
LIMIT = 3600  # seconds of one run
FEW = 50  # messages that each command line is tried with


class NotMeasured(Exception):
    """Why something cannot be measured."""


# Running ---------------------------------------------------------------------------------------------------------

def surroundings(command):
    """How a command is started: tshark with a home of its own, and as a user for whom it loads plugins."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "WIRESHARK_", "YAPP_"))}
    options = {"stdin": subprocess.DEVNULL, "env": {**kept, "LC_ALL": "C.UTF-8", "TZ": "UTC"}}
    if command[0] == "tshark":
        options["env"]["HOME"] = str(tshark.home(plugin=False))
        options.update(tshark._user())
    return options


def check(status, errors):
    lines = [line for line in errors.splitlines() if "Running as user" not in line]
    if status != 0 or any("Lua:" in line for line in lines):
        raise NotMeasured((lines or [f"exit code {status}"])[0][:200])


def output(command):
    """What a command prints; raises NotMeasured where it fails or prints nothing."""
    try:
        done = subprocess.run(command, capture_output=True, timeout=LIMIT, check=False, **surroundings(command))
    except FileNotFoundError as error:
        raise NotMeasured(f"{error.filename} is not there") from error
    except (OSError, subprocess.SubprocessError) as error:
        raise NotMeasured(str(error)) from error
    check(done.returncode, done.stderr.decode("utf-8", "replace"))
    if not done.stdout.strip():
        raise NotMeasured(f"{command[0]} showed nothing")
    return done.stdout.decode("utf-8", "replace")


def measure(command):
    """One run: its Usage.

    The peak of memory includes this program's own at the start of the other one: so this one stays small."""
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, **surroundings(command))
        timer = threading.Timer(LIMIT, process.kill)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        check(process.returncode, errors.read().decode("utf-8", "replace"))
    return report.Usage(usage.ru_utime + usage.ru_stime, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024))


def measure_work(work, broken, runs, run=measure):
    """{ peer: list of Usage, or why it has none }.

    broken  { peer: why it is not to be measured };  run: what measures a command line"""
    results = {peer: broken.get(peer, []) for peer in work.commands}
    for _ in range(runs * work.times):
        for peer, command in work.commands.items():
            if isinstance(results[peer], list):
                try:
                    results[peer].append(run(command))
                except NotMeasured as error:
                    results[peer] = str(error)
    return results


# What is there ---------------------------------------------------------------------------------------------------

def python_with_can():
    """A Python that has python-can and yapp-tables: of an environment of its own, else the system's; and what it is."""
    ours = CACHE / "venv"
    packages = ("import can, deltalake, platform, yapp_tables; print('python-can', can.__version__, 'yapp-tables', "
                "yapp_tables.__version__, 'on Python', platform.python_version())")
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        if not (ours / "bin/python").exists():
            subprocess.run([sys.executable, "-m", "venv", ours], check=True, capture_output=True)
        if subprocess.run([ours / "bin/python", "-c", packages], capture_output=True, check=False).returncode:
            subprocess.run([ours / "bin/python", "-m", "pip", "install", "-q", "python-can", "-e", f"{TOP}/tools[delta]"], check=True, capture_output=True)
    for python in (str(ours / "bin/python"), "/usr/bin/python3"):
        with contextlib.suppress(NotMeasured):
            return python, output([python, "-c", packages]).strip()
    return "/usr/bin/python3", "the system's Python and python-can, without yapp-tables"


def try_out(asked, loaded):
    """Runs each command line on few messages: { title: { peer: why it cannot be measured } }."""
    unloaded = {}
    for peer, shark in loaded.items():
        try:
            output(shark.now("yapp.pcap", "-Y", "yapp.crc.status == 1"))
        except NotMeasured as error:
            unloaded[peer] = f"the plugin does not load: {error}"
    broken = {}
    for work in asked:
        why = broken[work.title] = {}
        for peer, command in work.commands.items():
            whose = "before" if peer.startswith("before") else "now" if peer.startswith(("now", "list", "one")) else peer
            try:
                if whose in unloaded:
                    raise NotMeasured(unloaded[whose])
                output(command)
            except NotMeasured as error:
                why[peer] = str(error)
    return broken


def lua_version():
    """The version of Lua in tshark: "5.2.4"; None where it does not say."""
    with contextlib.suppress(NotMeasured):
        found = re.search(r"with\s+Lua\s+([\d.]*\d)", output(["tshark", "--version"]))
        return found and found[1]


def pure_parts(capture, runs):
    """Seconds of the pure parts by tshark's Lua on its own; empty where it is not there."""
    lua = "lua" + ".".join((lua_version() or "5.2").split(".")[:2])
    try:
        times = [dict(line.split("\t") for line in output([lua, str(HERE / "parts.lua"), str(capture)]).splitlines())
                 for _ in range(runs)]
        return report.steps([{name: float(value) for name, value in one.items()} for one in times])
    except (NotMeasured, ValueError) as error:
        print(f"the pure parts: not measured: {error}")
        return {}


def commit(folder):
    """Which commit a checkout is at, with "-dirty" where it is not quite that."""
    with contextlib.suppress(NotMeasured):
        return " at " + output(["git", "-c", "safe.directory=*", "-C", str(folder), "describe", "--always", "--dirty"]).strip()
    return ""


def plugin_version(folder):
    with contextlib.suppress(OSError):
        found = re.search(r'^local VERSION = "(.*)"', (folder / "yapp.lua").read_text(encoding="utf-8"), re.MULTILINE)
        return (found[1] if found else "of no version") + commit(folder)
    return "not there"


def machine():
    """Model of the CPU, cores."""
    with contextlib.suppress(OSError):
        found = re.search(r"model name\s*:\s*(.*)", pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8"))
        if found:
            return f"{found[1]}, {os.cpu_count()} cores"
    return f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores"


# The whole -------------------------------------------------------------------------------------------------------

def about(options, python, load):
    """The lines of BENCH.md that say what was measured where."""
    try:
        version = ".".join(map(str, tshark.version()))
    except (OSError, subprocess.SubprocessError, IndexError):
        version = "not there"
    lines = [f"tshark {version}, Lua {lua_version() or 'not there'}; plugin {plugin_version(TOP)}" +
             (f"; before: {plugin_version(options.base)}" if options.base else ""), python,
             f"{machine()}, {platform.system()} {platform.release()}; load {load[0]:.1f} before, {os.getloadavg()[0]:.1f} after",
             f"{datetime.date.today()}; {options.messages:,} messages, {options.messages * traffic.FRAMES:,} frames; "
             f"RUNS={options.runs}" + (f" LONG={options.long}" if options.long else "")]
    return "".join(f"- {line}\n" for line in lines)


def all_works(options, python, usual, long):
    """What was asked for, on the traffic in two folders."""
    shark = works.Shark(TOP, usual)
    found = works.works(shark, python, options.messages)
    if options.long:
        found += works.long_works(shark, works.Shark(TOP, long), python)
    found = [work for work in found if options.only in work.title]
    return [works.with_version(work, TOP, options.base) for work in found] if options.base else found


def make_traffic(options, folder):
    """The folders of the usual and of the long traffic."""
    usual, long = traffic.make(folder / "usual", options.messages), folder / "long"
    if options.long:
        traffic.make(long, options.messages * works.LONGER, ["yapp.pcap", "isotp.pcap"])
        traffic.make(long, options.messages * works.LOG_LONGER, ["yapp.log"])
    return usual, long


def measure_all(options, folder, python):
    """The works, the results, and seconds of the pure parts."""
    few = traffic.make(folder / "few", FEW)
    broken = try_out(all_works(options, python, few, few), plugins(options, few))
    usual, long = make_traffic(options, folder)
    asked, results = all_works(options, python, usual, long), {}
    for work in asked:
        runs = options.long if work.title in works.LONG else options.runs
        results[work.title] = measure_work(work, broken[work.title], runs)
        print(work.title, *(f"{peer} {report.shown(report.median(results, work.title, peer)) or '-'}" for peer in work.commands),
              sep="  ", flush=True)
    return asked, results, pure_parts(usual / "yapp.pcap", options.runs)


def plugins(options, folder):
    found = {"now": works.Shark(TOP, folder)}
    return {**found, "before": works.Shark(options.base, folder)} if options.base else found


def text(options, head, asked, results, pure):
    return report.WHOLE.format(
        about=head, ratios=report.ratios(results, asked), seconds=report.seconds(results, asked),
        reasons=report.reasons(results), memory=report.memory(results),
        long=report.long_captures(results, options.messages * works.LOG_LONGER * traffic.FRAMES),
        where=report.where_text(results, pure, options.messages))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3, help="how often each command is run")
    parser.add_argument("--long", type=int, default=0, metavar="RUNS", help="long captures too, so often")
    parser.add_argument("--base", type=lambda path: pathlib.Path(path).resolve(), help="a checkout of another version")
    parser.add_argument("--messages", type=int, default=20_000)
    parser.add_argument("--only", default="", metavar="WORD", help="only works with this in their title; writes no file")
    parser.add_argument("--out", type=pathlib.Path, default=TOP / "docs/BENCH.md")
    options = parser.parse_args()
    load, (python, says) = os.getloadavg(), python_with_can()
    folder = tshark.writable_folder()
    try:
        asked, results, pure = measure_all(options, folder, python)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    said = text(options, about(options, says, load), asked, results, pure)
    print("", said, sep="\n")
    if not options.only:
        options.out.write_text(said, encoding="utf-8")


if __name__ == "__main__":
    main()
