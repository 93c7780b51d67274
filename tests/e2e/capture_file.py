# SPDX-License-Identifier: GPL-2.0-or-later
"""What capture files are made of: blocks of pcapng, records of pcap, the heads of Linux cooked captures."""
import struct

SOCKETCAN, SLL, SLL2 = 227, 113, 276


def pad(data):
    return data + bytes(-len(data) % 4)


def block(kind, body, order="<"):
    size = struct.pack(order + "I", len(pad(body)) + 12)
    return struct.pack(order + "I", kind) + size + pad(body) + size


def option(code, value, order="<"):
    return struct.pack(order + "HH", code, len(value)) + pad(value)


NANOSECONDS = option(9, b"\x09")  # of an interface
# Names of hosts, none: longer than what the plugin looks at when a file is opened, so other interfaces may follow.
LONG_BLOCK = block(4, struct.pack("<HHHH", 0, 0, 1, 65532) + b" " * 65532 + struct.pack("<HH", 0, 0))


def section(*interfaces, order="<"):
    """The head of a pcapng file."""
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order) + b"".join(interfaces)


def interface(linktype, name="", options=b"", order="<"):
    options = (option(2, name.encode(), order) if name else b"") + options
    return block(1, struct.pack(order + "HHI", linktype, 0, 0) + options, order)


def packet(at, data, of_interface=0, captured=None, options=b"", order="<"):
    """at: in the units of its interface."""
    kept = data[:captured]
    head = struct.pack(order + "5I", of_interface, at >> 32, at & 0xFFFFFFFF, len(kept), len(data))
    return block(6, head + pad(kept) + options, order)


def pcap_record(at, data, captured=None):
    """at: in microseconds."""
    kept = data[:captured]
    return struct.pack("<IIII", *divmod(at, 10**6), len(kept), len(data)) + kept


def pcap(linktype, packets):
    """A file of packets, each as pcap_record takes it."""
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, linktype)
    return head + b"".join(pcap_record(*one) for one in packets)


def sll(record, is_fd=False):
    return struct.pack(">HHH8xH", 0, 280, 0, 0x0D if is_fd else 0x0C) + record


def sll2(record, index, is_fd=False):
    return struct.pack(">HHIHBB8x", 0x0D if is_fd else 0x0C, 0, index, 280, 0, 0) + record
