#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Feeds the plugin with damaged captures: fuzz.py --frames 100000 --seed 1

Takes the random captures of the soak tests, flights and the captures of test_captures, damages them, and shows each file to tshark and sharkd in several ways: one pass, two passes, all of the tree, fields,
filters, statistics, frames at random.  A way fails on a Lua error, a crash, more than its time or its memory.
What fails is kept in test_captures/fuzz, to be made small by hand, and replayed by tests/e2e/test_fuzz_findings.py.

The same seed makes the same files and calls on each Wireshark, as long as test_captures has the same files; what editcap
damages depends on its version.  Only the frames that tshark read count, and each once, however often it was shown.
"""
import argparse
import concurrent.futures
import functools
import hashlib
import json
import multiprocessing
import os
import pathlib
import random
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import tshark  # noqa: E402

import fuzz_files  # noqa: E402
import model  # noqa: E402
from fuzz_files import FINDINGS, Capture  # noqa: E402

# What a run may take: more is a failure.
CPU_SECONDS, CPU_SECONDS_A_FRAME = 20, 0.01
SECONDS = 120  # of waiting, for what hangs without working
RSS_MIB, RSS_MIB_A_FRAME = 400, 0.05
ADDRESS_SPACE, OUTPUT = 6 * 2**30, 2**30  # for the machine's sake


# Preferences -------------------------------------------------------------------------------------------------------

RANGES = ("", "0", "0x210", "0x210,0x211,0x300-0x303", "0-2047", "2047", "0x300-0x2ff", "0,0,0", "5-7,6-9")
OTHERS = ("can.byte_swap:TRUE", "can.try_heuristic_first:TRUE", "tcp.desegment_tcp_streams:FALSE",
          "tcp.reassemble_out_of_order:TRUE", "tcp.try_heuristic_first:TRUE", "udp.try_heuristic_first:TRUE",
          "ip.defragment:FALSE", "tcp.check_checksum:TRUE")


@functools.lru_cache(None)
def our_preferences():
    """{ preference: the values to choose from }, as tshark tells them."""
    text = subprocess.run(["tshark", "-G", "currentprefs"], env=environment(True), text=True, capture_output=True,
                          check=False, **tshark._user()).stdout
    found = {}
    for comment, name, value in re.findall(r"((?:^#.*\n)*)\n?^#?(yapp[_a-z]*\.\w+):(.*)$", text, re.M):
        if value.strip().upper() in ("TRUE", "FALSE"):
            found[name] = ("TRUE", "FALSE")
        elif name.endswith("user_dlt"):
            found[name] = ("", "147", "147-162", "1", "162,150-152")
        elif "One of:" in comment:
            found[name] = tuple(one.strip() for one in re.search(r"One of: (.*)", comment)[1].split(", "))
        else:
            found[name] = RANGES
    assert "yapp.all_extended" in found, "tshark does not know the plugin's preferences: is it loaded?"
    return found


def preferences(rng):
    chosen = [["-o", f"{name}:{rng.choice(values)}"] for name, values in our_preferences().items()
              if rng.random() < 0.15]
    if rng.random() < 0.2:
        chosen.append(["-o", rng.choice(OTHERS)])
    if rng.random() < 0.05:
        chosen.append(["--disable-protocol", rng.choice(("yapp", "taurus", "yapp_serial"))])
    return chosen


# Runs --------------------------------------------------------------------------------------------------------------

PLUGIN = ROOT
LONGEST = 6000  # frames of a file
SHORT = 10_000  # shorter ones are shown in three ways, longer ones in two: a tree takes its time


# Wireshark loses an error of a first pass (-2, sharkd), and of a run that prints no tree.  So what Wireshark calls in the
# copy under test says on stderr what went wrong, and raises it again.  All in one line: the others keep their numbers.
TRACE = """local function traced(f) return function(...)
  local function say(what) io.stderr:write("Lua: ", tostring(what), "\\n") return what end
  local done = table.pack(xpcall(f, say, ...))
  if not done[1] then error(done[2], 0) end
  return table.unpack(done, 2, done.n)
end end """.replace("\n", " ")


def trace(path):
    text = path.read_text()
    for pattern, new, least in (
            (r"(?ms)^function (yapp\.init)\(([^)]*)\)(\n.*?)^end$", r"\1 = traced(function(\2)\3end)", 1),
            (r"(?m)^(    local result = )call\(", r"\1traced(call)(", 1),  # counted: all others, heuristics too
            (r"(?m)^(\w+\.prefs_changed = )(\w+)$", r"\1traced(\2)", 1)):
        text, count = re.subn(pattern, new, text)
        assert count >= least, f"{path}: what Wireshark calls is not written as {pattern} any more"
    path.write_text(TRACE + text)


@functools.lru_cache(None)
def homes():
    """Two homes: one without a plugin, one with it installed."""
    folder = pathlib.Path(tempfile.mkdtemp(prefix="yapp-fuzz-"))
    plugins = folder / "installed/.local/lib/wireshark/plugins/yapp"
    (folder / "bare").mkdir()
    script = folder / "script"  # -X by a path that every user can reach
    trace(tshark.copy_plugin(script, PLUGIN) / "yapp.lua")
    tshark.install_plugin(plugins, script)
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    return folder


def environment(installed):
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "WIRESHARK_"))}
    return {**kept, **tshark.STRICT, "HOME": str(homes() / ("installed" if installed else "bare")), "LC_ALL": "C.UTF-8", "TZ": "UTC"}


# Ways to look at a file; placeholders stand for a file to write and one of STATISTICS.
FIELDS = [word for name in ("frame.number", "_ws.lua.error", "yapp.id", "yapp.crc.status", "taurus.motor.rpm_measured",
                            "yapp.reassembled.in", "yapp.time_delta") for word in ("-e", name)]
TREE = ("-V",)
TWO_PASSES = ("-2", "-T", "fields", *FIELDS)
FILTER = ("-Y", "_ws.lua.error")
WAYS = [
    TREE, TWO_PASSES, FILTER,
    ("-2", "-V"),
    ("-2", *FILTER),
    ("-2", "-Y", "yapp || taurus || _ws.lua.error"),
    ("-2", "-R", "yapp.crc.status == 1 || taurus || _ws.lua.error", "-V"),
    ("-2", "-R", "frame.number & 1", *FILTER),
    ("-T", "fields", *FIELDS),
    ("-T", "pdml"), ("-T", "json"), ("-T", "ek"), ("-x",),
    ("-2", "-q", "-z", "expert", *FILTER),
    ("-q", "-z", "expert", "-z", "io,stat,0,yapp,taurus.fault.active"),
    ("-P", "-w", "WRITE", "-F", "pcapng"),
    ("-q", "-z", "STATISTIC"),
    ("-2", "-q", "-z", "STATISTIC"),
    ("sharkd",),
]
STATISTICS = (*(f"yapp,{name}{form}" for name in model.IN_TEXT for form in ("", ",json")), "yapp,csv,WRITE,replace,all",
              "yapp,check,fault=0,crc=0,motor.gap=0.1,motor.dc_voltage=20..60")
OUR_CODES = (20, 21)  # a rule of check does not hold; something could not be judged, in other statistics too


def limits(frames, size):
    def apply():
        cpu = int(CPU_SECONDS + frames * CPU_SECONDS_A_FRAME + size * 2e-6)
        resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
        resource.setrlimit(resource.RLIMIT_FSIZE, (OUTPUT, OUTPUT))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    return apply


DAMAGED_FILE = re.compile(r"cut short|damaged|corrupt|isn't a capture file|can't be read|isn't supported|aren't saved|"
                          r"can't be written|too big|not a valid|invalid|can't be saved|appears to have been")


# An error in Lua; and an exception of Wireshark's own that goes through our code: Lua never gets back what it takes of
# the stack, and after a hundred of them nothing works any more.
ERROR = re.compile(rb"Lua Error[^\n\"]*|_ws\.lua\.error[^\n]*|Dissector bug, protocol (?:YAPP|TAURUS)[^\n\"]*|"
                   rb"Malformed Packet: (?:YAPP|TAURUS)|limited during capture: (?:YAPP|TAURUS)|"
                   rb" (?:YAPP|TAURUS)[^\n]* (?:Malformed Packet|Dissector bug|Packet size limited)")  # of -z expert


class Run:
    """One call of tshark or sharkd: .problem is None or what went wrong."""

    def __init__(self, path, arguments, way, frames, plugin=True, installed=False):
        words = [word for group in arguments for word in group]
        stdin = subprocess.DEVNULL
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, tempfile.TemporaryFile() as requests:
            if way[0] == "sharkd":
                # Preferences come by request; what the command line alone can say is left out.
                requests.write(sharkd_requests(path, arguments, frames))
                requests.seek(0)
                command, installed, stdin = ["sharkd", "-"], plugin, requests
            else:
                load = [] if installed or not plugin else ["-X", f"lua_script:{homes() / 'script/yapp.lua'}"]
                written = str(path) + ".out"
                command = ["tshark", *load, *words, "-r", str(path), *(w.replace("WRITE", written) for w in way)]
            size = path.stat().st_size
            child = subprocess.Popen(command, stdin=stdin, stdout=out, stderr=err,
                                     env=environment(installed and plugin), preexec_fn=limits(frames, size),
                                     **tshark._user())
            self.usage = self.wait(child, SECONDS + frames * CPU_SECONDS_A_FRAME)
            self.code = child.returncode
            out.seek(0)
            err.seek(0)
            self.out, self.err = out.read(), err.read().decode("utf-8", "replace")
        self.command = command
        self.cpu, self.rss = self.usage.ru_utime + self.usage.ru_stime, self.usage.ru_maxrss / 1024
        self.problem, self.not_ours = self.judge(frames, size), None

    @staticmethod
    def wait(child, seconds):
        deadline = time.monotonic() + seconds
        while True:
            pid, status, usage = os.wait4(child.pid, os.WNOHANG)
            if pid:
                child.returncode = os.waitstatus_to_exitcode(status)
                return usage
            if time.monotonic() > deadline:
                child.kill()
                deadline = float("inf")
            time.sleep(0.005)

    def frames_read(self):
        """Of TWO_PASSES: the number of frames, and how many of them are YAPP's."""
        lines = [line.split(b"\t") for line in self.out.splitlines()]
        return len(lines), sum(len(line) > 2 and line[2] != b"" for line in lines)

    def judge(self, frames, size):
        if self.code in (-signal.SIGXCPU, -signal.SIGKILL):
            return f"hang: more than its time or killed, {self.cpu:.0f} s of CPU"
        if self.code < 0:
            return f"crash: signal {-self.code}: {self.err.strip()[-300:]}"
        if self.rss > RSS_MIB + frames * RSS_MIB_A_FRAME + size / 2**20 * 20:
            return f"memory: {self.rss:.0f} MiB"
        found = ERROR.search(self.out)
        if found:
            return found[0].decode("utf-8", "replace")
        found = re.search(r"Dissector bug, protocol (YAPP|TAURUS).*", self.err)
        if found:
            return re.sub(r"in packet \d+: ", "", found[0])
        found = re.search(r"Lua:.*", self.err)
        if found:
            return found[0]
        is_verdict = self.code in OUR_CODES and any("yapp," in word for word in self.command)
        if self.code and not is_verdict and not DAMAGED_FILE.search(self.err):
            return f"exit code {self.code}: {self.err.strip().splitlines()[-1:]}"
        return None


def sharkd_requests(path, arguments, frames):
    """Loads the file twice and looks at frames at random."""
    rng, requests = random.Random(frames), []

    def ask(method, **parameters):
        request = {"jsonrpc": "2.0", "id": len(requests) + 1, "method": method}
        requests.append({**request, "params": parameters} if parameters else request)

    for option, *value in arguments:
        if option == "-o" and value[0].startswith("yapp."):
            name, _, text = value[0].partition(":")
            ask("setconf", name=name, value=text)
    for _ in range(2):
        ask("load", file=str(path))
        ask("frames", limit=min(frames, 300))
        for _ in range(30):
            ask("frame", frame=rng.randint(1, max(1, frames)), proto=True, columns=True)
        ask("frames", filter="yapp.crc.status == 1 || _ws.lua.error", limit=50)
    ask("bye")
    return "".join(json.dumps(request) + "\n" for request in requests).encode()


def signature(problem):
    """The same fault gives the same signature."""
    return re.sub(r"\S*/|\d+(?!:)", "", problem)[:120]


# A file, from making it to judging it ------------------------------------------------------------------------------

def make(seed, number):
    """The file of this number, and the ways to look at it."""
    rng = random.Random(f"{seed}/{number}")
    capture = fuzz_files.make(rng, LONGEST)
    capture.arguments = capture.arguments + preferences(rng)
    ways = [TREE, TWO_PASSES, rng.choice(WAYS[2:])]
    if len(capture.units) > SHORT:
        ways = [TWO_PASSES, rng.choice(WAYS[:1] + WAYS[2:])]
    ways = [tuple(rng.choice(STATISTICS) if word == "STATISTIC" else word for word in way) for way in ways]
    return capture, ways, rng.random() < 0.5


OURS = re.compile(r"(yapp|taurus|_ws\.lua)[.\w]*")


def show_file(capture, way, folder, installed=False):
    path, groups, frames = folder / f"fuzz{capture.suffix}", capture.arguments, len(capture.units)
    capture.write(path)
    run = Run(path, groups, way, frames, installed=installed)
    if run.problem and re.match("crash|hang|exit|memory", run.problem):
        # Wireshark alone does the same: not our fault, but told.
        others = [group for group in groups if not OURS.search(group[-1])]
        plain = tuple("io,stat,0" if word.startswith(("io,stat", "yapp,")) else OURS.sub("frame", word) for word in way)
        alone = Run(path, others, plain, frames, plugin=False).problem
        if alone and alone.split()[0] == run.problem.split()[0]:
            run.problem, run.not_ours = None, run.problem
    return run


def one_file(seed, number):
    """Makes a file and looks at it: (its number, frames, frames of YAPP, problems with the way that shows each, what Wireshark
    does wrong alone)."""
    capture, ways, installed = make(seed, number)
    folder, counts, problems, not_ours = tshark.writable_folder(), (0, 0), [], []
    try:
        for way in ways:
            if way[0] == "sharkd" and not shutil.which("sharkd"):
                continue
            run = show_file(capture, way, folder, installed)
            counts = run.frames_read() if way == TWO_PASSES else counts
            problems += [(run.problem, way)] if run.problem else []
            not_ours += [run.not_ours] if run.not_ours else []
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return number, *counts, problems, not_ours


# Findings ----------------------------------------------------------------------------------------------------------

def keep(seed, number, problem, way):
    """Keeps a finding: its file, and the call that shows it."""
    capture, *_ = make(seed, number)
    name = hashlib.sha1(signature(problem).encode()).hexdigest()[:8]
    path = FINDINGS / f"{name}{capture.suffix}"
    capture.write(path)
    words = [word for group in capture.arguments for word in group]
    path.with_suffix(".args").write_text(f"# {problem}\n{shlex.join(words)}\n{shlex.join(way)}\n")
    return path, shlex.join([*words, "-r", path.name, *way])


AS_FOUND = []
EVERY_WAY = [TREE, TWO_PASSES, ("-2", *FILTER), ("sharkd",)]


def replay(path, ways=EVERY_WAY):
    """What goes wrong with a kept capture: as it was found, and in other ways; also that, as it was found, nothing is shown of
    it, unless by a filter that only an error passes."""
    sidecar = path.with_suffix(".args")
    lines = [line for line in sidecar.read_text().splitlines() if not line.startswith("#")] if sidecar.exists() else []
    arguments, found = (shlex.split(line) for line in (lines + ["", ""])[:2])
    as_found = tuple(found) or TREE
    shows = not set(FILTER) <= set(as_found)
    capture = Capture(path.suffix, b"", [path.read_bytes()], [arguments] if arguments else [])
    folder = tshark.writable_folder()
    try:
        for way in dict.fromkeys([as_found, *ways]):
            if way[0] != "sharkd" or shutil.which("sharkd"):
                run = show_file(capture, way, folder, tshark.ROUTE == "plugin")
                is_silent = shows and way == as_found and not run.out.strip()
                problem = run.problem or ("it printed nothing" if is_silent else None)
                if problem:
                    yield f"{shlex.join(way)}: {problem}"
    finally:
        shutil.rmtree(folder, ignore_errors=True)


# The run -----------------------------------------------------------------------------------------------------------

def results(seed, frames, jobs):
    """Results of file after file, in order, until there are enough frames."""
    done, number, running = 0, 0, []
    fork = multiprocessing.get_context("fork")  # the workers know the homes and the plugin
    with concurrent.futures.ProcessPoolExecutor(jobs, fork) as pool:
        while done < frames:
            while len(running) < 2 * jobs:
                running.append(pool.submit(one_file, seed, number))
                number += 1
            result = running.pop(0).result()
            done += result[1]
            yield result
        pool.shutdown(cancel_futures=True)


def run(seed, least, jobs):
    """Looks at files until they have so many frames; keeps what fails, each fault once.  Returns the exit code."""
    start, shown = time.monotonic(), time.monotonic()
    known, not_ours, files, bad, frames, yapp = set(), 0, 0, 0, 0, 0
    for number, count, ours, problems, others in results(seed, least, jobs):
        files, frames, yapp, bad, not_ours = files + 1, frames + count, yapp + ours, bad + bool(problems), not_ours + len(others)
        for problem, way in problems:
            if signature(problem) not in known and len(known) < 10:
                known.add(signature(problem))
                print(f"fuzz: file {number} of seed {seed}: {problem}", flush=True)
                path, command = keep(seed, number, problem, way)
                print(f"fuzz: kept: {path}\n      {command}", flush=True)
        for problem in others:
            print(f"fuzz: file {number} of seed {seed}: Wireshark alone too: {problem}", flush=True)
        if time.monotonic() - shown > 15:
            shown = time.monotonic()
            print(f"fuzz: {frames} frames, {files} files, {shown - start:.0f} s", flush=True)
    print(f"fuzz: tshark {'.'.join(map(str, tshark.version()))}, seed {seed}, {frames} frames, {yapp} of them YAPP's, in {files} files, "
          f"{time.monotonic() - start:.0f} s; {len(known)} findings, {not_ours} of Wireshark alone")
    print(f"{files - bad} passed, {bad} failed")
    return 1 if bad or not files else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=100_000)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--file", type=int, help="look at this file of the seed only")
    options = parser.parse_args()
    homes()  # before the workers start, for all of them
    try:
        our_preferences()
        if options.file is not None:
            print(one_file(options.seed, options.file))
            return 0
        return run(options.seed, options.frames, options.jobs)
    finally:
        shutil.rmtree(homes(), ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
