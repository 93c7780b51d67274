#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What traffic of the worst kind costs, the longer it is: make hostile, make hostile RUNS=3 PACKETS=20000

Prints the CPU that a packet takes in four times as long a capture, over that in the short one: about 1 where the work for a
packet and what is kept open are bounded.  Least of RUNS runs, less what a start takes.  Never fails.
"""
import argparse
import itertools
import shutil
import struct

import bench  # which finds the rest
import traffic
import tshark

LONGER, LIMIT = 4, 1.3
NEVER = 65535  # bytes of a message that never ends


def header(ident, size):
    return b"YP" + struct.pack("<BBIHH", 0, 0, ident, size, 0)


def streams(chunk):
    """Packets of a stream of these bytes, again and again."""
    rest = itertools.cycle(chunk)
    while True:
        yield traffic.FOR_YAPP + bytes(itertools.islice(rest, traffic.UART_PACKET))


def can(frames):
    for can_id, data in frames:
        yield struct.pack(">IBxxx", can_id | 0x80000000, len(data)) + data.ljust(8, b"\0")


def start(size, crc=0):
    return struct.pack("<IHH", crc, size, 0)


def endless(starts):
    """So many Starts of 65,535 bytes, then Middles for ever."""
    yield from itertools.repeat((traffic.START, start(NEVER)), starts)
    for number in itertools.count():
        yield traffic.MIDDLE, struct.pack("<Q", number)


def ends():
    """Two Starts of 65,535 bytes, then Ends that complete nothing."""
    yield from itertools.repeat((traffic.START, start(NEVER)), 2)
    for number in itertools.count():
        yield traffic.END, struct.pack("<Q", number)


def hopeless():
    """Two messages of one key, mixed, that no frames make up."""
    while True:
        yield from itertools.repeat((traffic.START, start(40)), 2)
        for at in range(60):
            yield (traffic.END if at % 2 else traffic.MIDDLE), bytes([at])


def doubled():
    """Frames that came twice, of messages that are too long for it."""
    while True:
        yield traffic.START, start(NEVER)
        for at in range(400):
            yield from itertools.repeat((traffic.MIDDLE, bytes([at % 251] * 8)), 2)


# "All keys": what the ids cost in SocketCAN's table, each once, is in the short capture's too.
CASES = {
    "stream: YP at every byte": (traffic.EXPORTED_PDU, lambda: streams(b"YP")),
    "stream: a header at every 12 bytes, of 65,535": (traffic.EXPORTED_PDU, lambda: streams(header(0x123, NEVER))),
    "stream: headers of known messages": (traffic.EXPORTED_PDU, lambda: streams(header(0x210, 32) + b"x")),
    "stream: headers of all sizes": (traffic.EXPORTED_PDU, lambda: streams(
        b"".join(header(0x123, size) for size in range(1, NEVER, 997)))),
    "CAN: a message that never ends": (traffic.SOCKETCAN, lambda: can(endless(1))),
    "CAN: two of them": (traffic.SOCKETCAN, lambda: can(endless(2))),
    "CAN: two Starts, then Ends": (traffic.SOCKETCAN, lambda: can(ends())),
    "CAN: Starts of one key without end": (traffic.SOCKETCAN, lambda: can(itertools.repeat((traffic.START, start(NEVER))))),
    "CAN: Starts of all keys": (traffic.SOCKETCAN, lambda: can(
        ((number * 7919 % 0x800) << 18 | 0x4000 | number // 0x800 % 0x100, start(NEVER)) for number in itertools.count())),
    "CAN: messages that nothing makes up": (traffic.SOCKETCAN, lambda: can(hopeless())),
    "CAN: frames that came twice": (traffic.SOCKETCAN, lambda: can(doubled())),
}


def least(shark, name, runs):
    return min(bench.measure(shark.command(bench.Work("", name, []), "now"))[0] for _ in range(runs))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--packets", type=int, default=10_000, help="of a short capture")
    parser.add_argument("--only", default="", metavar="WORD")
    options = parser.parse_args()
    folder = tshark.writable_folder()
    bench.prepare(folder, 1, {"now": bench.TOP})
    shark = bench.Tshark(None, folder)
    try:
        begin = least(shark, "one.pcap", 2 * options.runs)
        print(f"start {begin:.2f} s; {options.packets:,} packets, and {LONGER} times as many")
        for title, (linktype, packets) in CASES.items():
            if options.only not in title:
                continue
            used = {}
            for times in (1, LONGER):
                count = options.packets * times * (1 if linktype == traffic.EXPORTED_PDU else LONGER)  # these are faster
                traffic.write_pcap(folder / "hostile.pcap", linktype, itertools.islice(packets(), count))
                used[times] = max(least(shark, "hostile.pcap", options.runs) - begin, 0.001) / count * 1e6
            ratio = used[LONGER] / used[1]
            print(f"{title:48} {used[1]:7.1f} {used[LONGER]:7.1f} µs a packet  {ratio:.2f}"
                  f"  {'' if ratio <= LIMIT else f'above {LIMIT}'}".rstrip(), flush=True)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
