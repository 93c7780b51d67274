# SPDX-License-Identifier: GPL-2.0-or-later
"""CRC-32K/6.4 for the generators, written from the document ("CRC Calculation") without a look at the plugin."""

POLYNOMIAL = 0x32C00699


def _shifted(register):
    for _ in range(8):
        register = (register << 1 ^ (POLYNOMIAL if register >> 31 else 0)) & 0xFFFFFFFF
    return register


TABLE = [_shifted(byte << 24) for byte in range(256)]


def crc32k(data):
    register = 0xFFFFFFFF
    for byte in data:
        register = (register << 8 & 0xFFFFFFFF) ^ TABLE[register >> 24 ^ byte]
    return register
