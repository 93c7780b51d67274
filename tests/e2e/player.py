#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Plays a bench to standard output as a live capture: two controllers, `left` and `right`, with Motor Data at 10 Hz each.

    player.py SECONDS | tshark -Q -i - -z yapp,watch

From a third of the time on, left has motor_overcurrent for 0.5 s; from half of it on, nothing comes of right.
The speeds are 1,000 and 2,000 rpm, the voltage 48 V.
"""
import struct
import sys
import time

sys.path.insert(0, __file__.rpartition("/")[0])
import capture_file  # noqa: E402
from can_generator import Sent  # noqa: E402

LEFT, RIGHT = 0x210, 0x211
OVERCURRENT = 0x10000
HEAD = capture_file.pcap(capture_file.SOCKETCAN, [])


def count(value, limit):
    """A compressed float of 16 bits, <-limit; limit>."""
    return round((value + limit) / (2 * limit) * 65530)


def motor(ident, seq, rpm, faults, clock):
    counts = [count(0, 128), count(0, 128), count(rpm, 60000), count(rpm, 60000), count(48, 128), count(2, 128)]
    return Sent(ident, 0, seq % 256, struct.pack("<6HBBIIqBB", *counts, 66, 1, 0x20000, faults, clock, 2, 66))


def packet(at, frame):
    record = struct.pack(">IB3x", 0x80000000 | frame.can_id, len(frame.data)) + frame.data
    return capture_file.pcap_record(int(at * 1e6), record)


def play(out, length):
    begin = time.time()
    out.write(HEAD)
    for step in range(int(length * 10)):
        after = step / 10
        time.sleep(max(0, begin + after - time.time()))
        faults = OVERCURRENT if length / 3 <= after < length / 3 + 0.5 else 0
        messages = [motor(LEFT, step, 1000, faults, step * 10**8)]
        if after < length / 2:
            messages.append(motor(RIGHT, step, 2000, 0, step * 10**8))
        for message in messages:
            for frame in message.frames():
                out.write(packet(begin + after, frame))
        out.flush()


if __name__ == "__main__":
    try:
        play(sys.stdout.buffer, float(sys.argv[1]))
    except BrokenPipeError:
        sys.stderr.close()
