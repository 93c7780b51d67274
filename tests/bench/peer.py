#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""What an engineer would write instead of the plugin: peer.py CANDUMP_LOG OUT.csv

python-can reads the log; reassembly, CRC check, scaling and CSV by hand.
"""
import csv
import pathlib
import struct
import sys

import can

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
from crc32k import crc32k  # noqa: E402

TOP = 65530  # counts of a compressed float
NAMES = ("time torque_iq_commanded torque_iq_measured rpm_commanded rpm_measured dc_voltage dc_current motor_temperature "
         "motor_mode status_flags fault_flags timestamp motor_state esc_temperature").split()


def row(time, payload):
    v = struct.unpack("<6HBBIIqBB", payload)
    amps = [-128 + c * 256 / TOP for c in (v[0], v[1], v[4], v[5])]
    rpm = [-60000 + c * 120000 / TOP for c in v[2:4]]
    return time, *amps[:2], *rpm, *amps[2:], v[6] - 40, *v[7:12], v[12] - 40


def payloads(log):
    """The good messages of a log: time and payload."""
    transfers = {}
    for m in can.LogReader(log):
        mid, ctrl = m.arbitration_id >> 18, m.arbitration_id >> 14 & 15
        key = m.channel, mid
        if ctrl == 1:
            transfers[key] = struct.unpack("<IH", m.data[:6]), bytearray()
        elif key in transfers:
            (crc, size), data = transfers[key]
            data += m.data
            if ctrl == 3:
                del transfers[key]
                head = b"YP" + struct.pack("<BBIHH", m.arbitration_id & 255, 0, mid, size, 0)
                if len(data) == size and crc32k(head + data) == crc:
                    yield m.timestamp, data


def main(log, out):
    count = 0
    with open(out, "w", newline="", encoding="ascii") as file:
        rows = csv.writer(file)
        rows.writerow(NAMES)
        for time, payload in payloads(log):
            rows.writerow(row(time, payload))
            count += 1
    print(count, "messages")


if __name__ == "__main__":
    main(*sys.argv[1:])
