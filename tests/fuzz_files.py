# SPDX-License-Identifier: GPL-2.0-or-later
"""The files that fuzz.py shows: the random captures of the soak tests, flights, and the captures of the repository; all damaged.

Everything comes out of a random.Random: the same one makes the same file.
"""
import functools
import math
import pathlib
import re
import shlex
import struct
import subprocess
import tempfile

import can_generator
import flights
import stream_captures

CAPTURES = pathlib.Path(__file__).resolve().parents[1] / "test_captures"
FINDINGS = CAPTURES / "fuzz"
KINDS = (".pcap", ".pcapng", ".log", ".txt", ".asc", ".yapp", ".bin")
TEXTS = (".log", ".txt", ".asc")


class Capture:
    """A file as its head and its units (records, lines, chunks), and the arguments to read it with, in groups."""

    def __init__(self, suffix, head, units, arguments):
        self.suffix, self.head, self.units, self.arguments = suffix, head, units, arguments

    def write(self, path):
        path.write_bytes(self.head + b"".join(self.units))
        path.chmod(0o644)


def split(suffix, data):
    """The head, for pcapng with all interfaces, and the units of a file."""
    head, units, at = b"", [], 24 if suffix == ".pcap" else 0
    if suffix in TEXTS:
        return b"", data.splitlines(keepends=True)
    if suffix not in (".pcap", ".pcapng"):
        return b"", [data[at:at + 64] for at in range(0, len(data), 64)]
    while at + 12 <= len(data):
        kind, size = struct.unpack_from("<II", data, at) if suffix == ".pcapng" else (6, 16 + struct.unpack_from("<I", data, at + 8)[0])
        if size < 12:
            break
        if kind in (0x0A0D0D0A, 1):
            head += data[at:at + size]
        else:
            units.append(data[at:at + size])
        at += size
    return data[:24] if suffix == ".pcap" else head, units


def groups(words):
    return [list(words[at:at + 2]) for at in range(0, len(words), 2)]


# Whole files: rng, number of frames -> suffix, content, arguments -----------------------------------------------------

def can(rng, count, path):
    capture = can_generator.capture(rng.getrandbits(32), rng.choice(can_generator.LAYOUTS), rng.random() < 0.3, 1, count)
    capture.write(path)
    return ".pcapng" if capture.layout in can_generator.INTERFACES else ".pcap", capture.preferences


def stream(rng, count, path):
    capture = stream_captures.capture(rng.choice(list(stream_captures.TRANSPORTS)), rng.getrandbits(32), count // 20 + 1)
    capture.write(path)
    return ".pcapng", capture.options


def flight(rng, _, path):
    form = rng.choice(flights.FORMS)
    one = flights.make(rng.getrandbits(32))
    one.write(path, form)
    return ".log" if form == "candump" else ".pcapng", one.arguments(form)


@functools.lru_cache(None)
def corpus():
    return sorted(path for kind in ("can", "serial", "candump", "other") for path in (CAPTURES / kind).iterdir()
                  if path.suffix in KINDS)


def known_capture(rng, count, path):
    """A capture of ours, with the options that its text names."""
    known = rng.choice(corpus())
    path.write_bytes(known.read_bytes())
    text = known.with_suffix(".frames")
    line = re.search(r"^options (.*)$", text.read_text(), re.M) if text.exists() else None
    return known.suffix, shlex.split(line[1]) if line else []


def by_editcap(rng, count, path):
    """What Wireshark's own tool does to packets."""
    suffix, arguments = rng.choice((can, stream))(rng, count, path)
    command = ["editcap", "-F", "pcapng", "-E", str(rng.choice((0.001, 0.01, 0.05))), "--seed", str(rng.getrandbits(31)), path,
               path.with_name("edited")]
    subprocess.run(command, capture_output=True, check=False)
    if not path.with_name("edited").exists():
        return suffix, arguments
    path.write_bytes(path.with_name("edited").read_bytes())
    return ".pcapng", arguments


MAKERS = [can] * 4 + [stream] * 4 + [flight] * 2 + [known_capture] * 4 + [by_editcap] * 2


# Damage --------------------------------------------------------------------------------------------------------------

def damaged(rng, units, skip):
    """Units with what happens on the way: bits flip, bytes go and come, units are lost, twice or early.

    skip: bytes of a record's header, which are damaged seldom: the rest of the file would be lost."""
    rate, done = rng.choice((0, 0.01, 0.1, 0.3)), []
    for unit in units:
        kind = rng.random() / rate if rate else 1
        at = rng.randrange(skip if rng.random() < 0.98 and len(unit) > skip else 0, len(unit)) if unit else 0
        if kind < 0.5 and unit:
            unit = unit[:at] + bytes([unit[at] ^ 1 << rng.randrange(8)]) + unit[at + 1:]
        elif kind < 0.6 and not skip:  # a record of another length is no record
            unit = rng.choice((unit[:at] + unit[at + 1:], unit[:at] + b"\n", unit[:at] + unit[at:] * rng.choice((2, 10)),
                               b"# comment\n", b"DROPCOUNT: dropped 3 CAN\n", b"\t\t\n"))
        elif kind < 0.62 and not skip and rng.random() < 0.05:
            unit = unit.rstrip(b"\n") + rng.choice((b"0", b" ", b"A5")) * 200_000 + b"\n"
        elif kind < 0.7:
            done.append(unit)
        elif kind < 0.8:
            continue
        done.append(unit)
        if kind < 0.05 and len(done) > 1:
            done[-2:] = done[:-3:-1]
    return done


def make(rng, longest):
    """A damaged file of 30 to so many frames, as often short as long: Capture."""
    count = int(10 ** rng.uniform(1.5, math.log10(longest)))
    with tempfile.TemporaryDirectory() as name:
        path = pathlib.Path(name) / "file"
        suffix, arguments = rng.choice(MAKERS)(rng, count, path)
        head, units = split(suffix, path.read_bytes())
    units = (units * (min(count, 500) // max(1, len(units)) + 1))[:max(count, 1)]
    return Capture(suffix, head, damaged(rng, units, {".pcap": 16, ".pcapng": 28}.get(suffix, 0)), groups(arguments))
