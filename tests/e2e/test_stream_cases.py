# SPDX-License-Identifier: GPL-2.0-or-later
"""What people record of YAPP in streams: captures that showed a defect of 2.2, and relatives of each."""
import ipaddress
import json
import random
import re
import shutil
import struct

import pytest

import levels
import stream_captures
import test_readme
import tshark
from stream_captures import ETHERNET, USBMON, USBPCAP, Origin, Packet, frame, usbmon, usbpcap, with_status

CASES = tshark.CAPTURES / "cases"
MOTOR_DATA, HEALTH = 0x210, 0x200
# Random streams are read in both, see test_streams.py.
PASSES = pytest.mark.parametrize("passes", [[], pytest.param(["-2"], marks=levels.deep)], ids=["one pass", "two"])


def statistics(path, *arguments, code=0):
    """What tshark answers to faults, summary and events: for each source (bus, id) its count, and all events."""
    done = tshark.run("-q", "-r", path, *arguments, "-z", "yapp,summary,json", "-z", "yapp,events,json", check=False)
    assert done.returncode == code, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    counts = {(row["bus"], row["id"]): row["count"] for row in rows if row.get("count") and "kind" not in row}
    return counts, [row for row in rows if "kind" in row]


def raised(events):
    """The sources of which a message raised a fault, once for each such message."""
    found = {(row["frame"], row["bus"], row["source"]): None for row in events if row["kind"] == "fault" and row["event"] == "raised"}
    return [source for _, *source in found]


def kinds(events):
    return {row["kind"] for row in events}


def flight(count=20, fault=10, boot=0):
    """The Motor Data of a controller at 10 Hz, each with its time in seconds, and a fault of two messages.  boot: how many
    seconds it is on when the capture begins."""
    messages = []
    for number in range(count):
        flags = 2 if fault is not None and fault <= number < fault + 2 else 0
        payload = struct.pack("<6HBBIIqBB", *[32765] * 6, 70, 1, 0x40010000, flags, (10 * boot + number) * 100_000_000, 2, 80)
        messages.append((number * 0.1, frame(MOTOR_DATA, payload, seq=number % 256)))
    return messages


def written(folder, packets, link, name="run.pcapng"):
    """A capture of packets, (seconds, sender's number, bytes) each."""
    made = []
    for seconds, packet in packets:
        packet.time = stream_captures.EPOCH + round(seconds * 1e6)
        made.append(packet)
    made.sort(key=lambda packet: packet.time)
    stream_captures.Capture("", made, link, []).write(folder / name)
    return folder / name


def test_another_transport(folder):
    """DCCP, by a script of the user's: its packets are a stream, and not those of a raw dump."""
    (folder / "dccp.lua").write_text('DissectorTable.get("dccp.port"):add(40, Dissector.get("yapp_serial"))')
    parts = [(at, Packet(part, Origin(ETHERNET, 1, 2))) for at, data in flight() for part in (data[:20], data[20:])]
    path = written(folder, parts, lambda packet: stream_captures.ethernet(packet, 33, struct.pack(">HHI8x", 30, 40, 4 << 24) + packet.data))
    assert sum(statistics(path, "-X", f"lua_script:{folder / 'dccp.lua'}")[0].values()) == 20


# Names -----------------------------------------------------------------------------------------------------------

# Capture, what the user writes of its bus, and another one; test_sources.lua has all of a bus's names.
NAMED_SOURCES = [("udp_named_by_address.pcap", "192.168.1.10", "292.168.1.10"), ("usb_named_by_device.pcap", "usb1.6", "usb2.6"),
                 ("uart_named_by_interface.pcapng", "ttyS0", "ttyS1")]


@PASSES
@pytest.mark.parametrize("name, own, other", NAMED_SOURCES)
def test_a_source_that_bears_its_name_is_not_absent(name, own, other, passes):
    option = ["-o", f"yapp.sources:{own}/0x210=motor:a,{other}/0x210=motor:b", "-o", "yapp.user_dlt:147"]
    done = tshark.run("-q", "-r", CASES / name, *option, *passes, "-z", "yapp,check,json,absent=0", "-z", "yapp,events,json", check=False)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 20 and [row["bus"] for row in rows if row.get("kind") == "absent"] == [other], rows


@PASSES
def test_each_receiver_of_commands_is_a_source(passes):
    """One socket commands three controllers, the second until 3 s."""
    counts, events = statistics(CASES / "udp_commands_to_three.pcap", *passes)
    addresses = [f"192.168.1.{last}" for last in (11, 12, 13)]
    assert {bus for bus, ident in counts if ident == 0} == set(addresses)
    assert [(row["bus"], row["id"]) for row in events if row["kind"] == "silence"] == [(addresses[1], 0)]
    assert kinds(events) == {"silence"}


@PASSES
def test_controllers_behind_one_address(folder, passes):
    """They are one source, which is said, unless the user names their ports."""
    packets = []
    for number in range(5):
        packets += [(seconds + number / 1000, Packet(data, Origin(ETHERNET, 0, 2 * number)))
                    for seconds, data in flight(fault=10 if number == 3 else None, boot=number)]
    path = written(folder, packets, stream_captures.udp)
    _, events = statistics(path, *passes, code=21)
    assert "shared" in kinds(events)
    names = ",".join(f"192.0.2.1:{50000 + number}/0x210=motor:M{number}" for number in range(5))
    counts, events = statistics(path, *passes, "-o", f"yapp.sources:{names}")
    assert counts == {(f"192.0.2.1:{50000 + number}", MOTOR_DATA): 20 for number in range(5)}
    assert raised(events) == [["192.0.2.1:50003", "M3"]]


@levels.by_version
@PASSES
@pytest.mark.parametrize("seed", range(levels.size(1, 12)))
def test_an_address_is_a_number(folder, seed, passes):
    """Whatever name resolution does: names for some addresses, one of them for several."""
    rng = random.Random(f"names {seed}")
    zeros = [0, 0, 0, rng.getrandbits(16), rng.getrandbits(4)]
    addresses = ["%d.%d.%d.%d" % tuple(rng.randbytes(4)) for _ in range(3)]
    addresses += [ipaddress.IPv6Address(struct.pack(">8H", 0xFD00, *(rng.choice(zeros) for _ in range(6)), rng.getrandbits(16)))
                  for _ in range(5)]
    packets = [(seconds + number / 1000, Packet(data, Origin(ETHERNET, 0, number, str(address))))
               for number, address in enumerate(addresses) for seconds, data in flight()[:4]]
    path = written(folder, packets, from_address)
    (folder / "hosts").write_text("".join(f"{one} drone-{rng.randrange(2)}\n" for one in addresses if rng.random() < 0.8))
    texts = [str(address) for address in addresses]
    parts = ",".join(f"{text}/0x210=motor:M{number}" for number, text in enumerate(texts))
    arguments = ["-H", folder / "hosts", "-N", "n", "-o", f"yapp.sources:{parts}", *passes]
    found = tshark.fields(path, ["yapp.bus", "yapp.source"], "-Y", "taurus.motor", *arguments)
    assert {tuple(row) for row in found} == {(text, f"M{number}") for number, text in enumerate(texts)}


def from_address(packet):
    address = ipaddress.ip_address(packet.origin.address)
    data = struct.pack(">HHHH", 14550, 20001, 8 + len(packet.data), 0) + packet.data
    if address.version == 6:
        header = struct.pack(">IHBB", 6 << 28, len(data), 17, 64) + address.packed + bytes(15) + b"\2"
        return bytes(12) + b"\x86\xdd" + header + data
    header = struct.pack(">BBHIBBH", 0x45, 0, 20 + len(data), 0, 64, 17, 0) + address.packed + bytes([192, 0, 2, 9])
    return bytes(12) + b"\x08\0" + header + data


# Byte streams in UDP ---------------------------------------------------------------------------------------------

@levels.each_once
@PASSES
@pytest.mark.parametrize("length, start", [(1, 0), (7, 0), (8, 9), (16, 33), (16, 7), (16, 9), (48, 3), (57, 2)])  # a bridge's
@pytest.mark.parametrize("link", [stream_captures.udp, stream_captures.tcp])
def test_headers_in_pieces(folder, link, length, start, passes):
    """They are counted until a packet has a whole one, and the option that decodes them is named."""
    data, heads = b"".join(data for _, data in flight(20 + bool(start)))[start:], range(-start % 48, 960, 48)
    packets = [(0.1 * at / 48, Packet(data[at:at + length], Origin(ETHERNET, 0, 0))) for at in range(0, len(data), length)]
    for at, (_, packet) in enumerate(packets):
        packet.sequence = 1000 + at * length
    path = written(folder, packets, link)
    done = tshark.run("-q", "-r", path, *passes, "-z", "yapp,faults", check=False)
    option = f"-d {link.__name__}.port==20001,yapp_serial"
    cut = next((at for at, head in enumerate(heads) if head % length + 12 <= length), 20)
    assert done.returncode == 21 and done.stdout.startswith("YAPP faults: UNKNOWN, ")
    assert re.search(f"{cut} YAPP headers? in this file w.* not decoded; try {option}", done.stderr), done.stderr
    assert sum(statistics(path, *passes, *option.split())[0].values()) == 20


@levels.by_version
@PASSES
def test_datagrams_of_others_in_a_conversation(passes):
    """MAVLink and YAPP: what holds no frame is left to its own dissector."""
    stub = ["-X", f"lua_script:{CASES / 'mavstub.lua'}"]
    rows = tshark.fields(CASES / "udp_mixed_mavlink.pcap", ["mavstub.len", "yapp.id", "yapp.skipped"], *passes, *stub)
    assert sum(bool(row[0]) for row in rows) == 24 and sum(bool(row[1]) for row in rows) == 24
    assert not any(row[2] or row[0] and row[1] for row in rows)
    counts, events = statistics(CASES / "udp_mixed_mavlink.pcap", *passes, *stub)
    assert sum(counts.values()) == 24 and len(raised(events)) == 1 and "skipped" not in kinds(events)


# Directions ------------------------------------------------------------------------------------------------------

USER_DLT = ["-o", "yapp.user_dlt:147"]


def test_directions_in_a_pipe():
    """The file cannot be read there beyond its first bytes, but those are all."""
    data = (CASES / "two_uarts_directions.pcapng").open("rb")
    rows = tshark.run(*USER_DLT, "-r", "-", "-q", "-z", "yapp,summary,json", stdin=data).stdout.splitlines()
    assert {(row["bus"], row["id"], row["crc_bad"]) for row in map(json.loads, rows)} == {
        ("ttyS0#rx", MOTOR_DATA, 0), ("ttyS0#rx", HEALTH, 0), ("ttyS0#tx", 0, 0)}


# USB adapters ----------------------------------------------------------------------------------------------------

ADAPTERS = {  # how the bytes come, and how many in a transfer
    "CP210x": (lambda data: data, 64), "byte by byte": (lambda data: data, 1),
    "FTDI, high speed": (lambda data: with_status(data, 512), 900), "FTDI, few bytes": (lambda data: with_status(data, 64), 5),
}


@levels.each_once
@levels.by_version
@pytest.mark.parametrize("how, linktype", [(usbmon, USBMON), (usbpcap, USBPCAP)], ids=["usbmon", "USBPcap"])
@pytest.mark.parametrize("adapter", ADAPTERS)
def test_usb_adapters(folder, adapter, how, linktype):
    """Both directions, without the adapter's descriptors; a mouse beside it."""
    carry, length = ADAPTERS[adapter]
    data = b"".join(data for _, data in flight())
    commands = b"".join(frame(0, struct.pack("<BBBHH", 1, 0xA5, 0, 40000, 30000), seq=number) for number in range(9))
    sent = [(3, 0x81, carry(data[at:at + length])) for at in range(0, len(data), length)]
    sent += [(3, 0x02, commands[at:at + 64]) for at in range(0, len(commands), 64)] + [(1, 0x83, b"YP\0\1")]
    packets = []
    for index, one in enumerate(sent):
        packet = Packet(one[2], Origin(linktype, 0, 0))
        packet.sequence = one
        packets.append((index / 500, packet))
    path = written(folder, packets, lambda packet: how(*packet.sequence, 7))
    rx, tx = ("usb2.7.1#rx", "usb2.7.2#tx")
    lost = int(length < 12)  # where no packet holds a whole header, the first message is skipped
    part = "usb2.7.1" if how == usbmon else "usb2.7"  # its endpoint, the adapter
    for name, options in levels.size([("left", ["-2"])], [(None, []), ("left", ["-2"])]):
        options += ["-o", f"yapp.sources:{part}/0x210=motor:left"] * bool(name)
        counts, events = statistics(path, *options)
        assert counts == {(rx, MOTOR_DATA): 20 - lost, (tx, 0): 9}
        assert raised(events) == [[rx, name]] and not kinds(events) & {"crc", "incomplete", "unfinished"}
        assert ("skipped" in kinds(events)) == bool(lost)


def test_foreign_usb_is_left_alone(folder):
    """A disk that sends what looks like YAPP here and there."""
    packets = []
    for index in range(50):
        packet = Packet(b"YP and more" * index + b"Y", Origin(USBMON, 0, 0))
        packets.append((index / 500, packet))
    path = written(folder, packets, lambda packet: usbmon(3, 0x81, packet.data, 7))
    assert statistics(path) == ({}, [])
    assert tshark.fields(path, ["frame.number"], "-Y", "yapp || frame.number == 7", "-o", "yapp.search_all:TRUE", "-2") == [["7"]]


# Bridges of real tools ---------------------------------------------------------------------------------------------

BRIDGES = {"127.0.0.1:4001": "ser2net, raw", "127.0.0.1:4003": "ser2net, UDP", "127.0.0.1:4006": "socat, TCP",
           "127.0.0.1:41110": "socat, UDP"}


@levels.by_version
@PASSES
def test_bridges_of_ser2net_and_socat(passes):
    """Each carried 16 Motor Data, 4 Health, and one fault, beside the text of a shell, in writes of 1 to 23 bytes.  Two more
    are in telnet mode, and all have one address: that is said."""
    path = CASES / "ser2net_socat.pcap"
    ports = [word for bus, name in BRIDGES.items()
             for word in ("-d", f"{'udp' if 'UDP' in name else 'tcp'}.port=={bus.split(':')[1]},yapp_serial")]
    names = "yapp.sources:" + ",".join(f"{bus}={name[-4:]}" for bus, name in BRIDGES.items())
    counts, events = statistics(path, *passes, *ports, "-o", names, code=21)
    assert {"crc", "shared"} <= {event["kind"] for event in events if event["bus"] not in BRIDGES}
    events = [event for event in events if event["bus"] in BRIDGES]
    assert {source: count for source, count in counts.items() if source[0] in BRIDGES} == \
        {(bus, ident): count for bus in BRIDGES for ident, count in ((MOTOR_DATA, 16), (HEALTH, 4))}
    for event in "raised", "cleared":
        assert sorted(one["bus"] for one in events if one.get("event") == event) == sorted(BRIDGES)
    assert not kinds(events) & {"crc", "incomplete", "unfinished", "missing", "shared", "reboot", "stale"}


# What is not found by content -------------------------------------------------------------------------------------

def advice(path, *arguments):
    done = tshark.run("-q", "-r", path, "-z", "yapp,faults", *arguments, check=False)
    return done.stdout + done.stderr


def test_what_is_not_found_is_named_with_the_command(folder):
    assert "try -o yapp.user_dlt:147" in advice(CASES / "two_uarts_directions.pcapng")
    assert "-d tcp.port==4001,yapp_serial" in advice(CASES / "tcp_8_byte_segments.pcap")
    packets = [(seconds, Packet(data, Origin(stream_captures.RTAC, 0, 0))) for seconds, data in flight()]
    path = written(folder, packets, stream_captures.rtac)
    assert "-d rtacser.data,yapp_serial" in advice(path)
    assert statistics(path, "-d", "rtacser.data,yapp_serial")[0] == {(None, MOTOR_DATA): 20}


def ported(packet):
    """A datagram or a segment: its ports are in `ports`, the kind in `kind`."""
    if packet.kind == "udp":
        return stream_captures.ethernet(packet, 17, struct.pack(">HHHH", *packet.ports, 8 + len(packet.data), 0) + packet.data)
    return stream_captures.ethernet(packet, 6, struct.pack(
        ">HHIIHHHH", *packet.ports, packet.sequence, 1, getattr(packet, "flags", 0x5018), 65535, 0, 0) + packet.data)


def with_ports(kind, ports, fault=10):
    """A flight for each pair of ports; the last one has the fault."""
    packets = []
    for number, pair in enumerate(ports):
        for index, (seconds, data) in enumerate(flight(fault=fault if number == len(ports) - 1 else None)):
            packet = Packet(data, Origin(ETHERNET, 0, 2 * number))
            packet.ports, packet.kind, packet.sequence = pair, kind, 1 + 48 * index
            packets.append((seconds + number / 1000, packet))
    return packets


@levels.each_once
@PASSES
@pytest.mark.parametrize("what", ["check", "csv,-,motor"])
def test_a_conversation_that_another_protocol_takes_is_no_all_clear(folder, passes, what):
    """HTTP has the server's port: what was decoded is well, but the fault is in the other one."""
    path = written(folder, with_ports("tcp", [(4001, 50000), (8080, 50000)]), ported)
    done = tshark.run("-q", "-r", path, *passes, "-z", f"yapp,{what}", check=False)
    assert done.returncode == 21 and "try -d tcp.port==8080,yapp_serial" in done.stdout + done.stderr
    done = tshark.run("-q", "-r", path, *passes, "-d", "tcp.port==8080,yapp_serial", "-z", "yapp,check", check=False)
    assert done.returncode == 20 and "was not decoded" not in done.stdout + done.stderr


@levels.by_version
@PASSES
def test_a_first_message_that_another_protocol_takes_is_no_all_clear(folder, passes):
    """Modbus has port 502, and takes the datagram whose Seq No is 0: it leaves the others, so they are found."""
    path = written(folder, with_ports("udp", [(40000, 502)], fault=None), ported)
    found = tshark.fields(path, ["yapp.seq"], "-Y", "yapp", *passes)
    assert found in ([], [[str(number)] for number in range(1, 20)])  # 4.6: Modbus takes them all
    done = tshark.run("-q", "-r", path, *passes, "-z", "yapp,check", check=False)
    assert done.returncode == 21 and "try -d udp.port==502,yapp_serial" in done.stdout
    done = tshark.run("-q", "-r", path, *passes, "-d", "udp.port==502,yapp_serial", "-z", "yapp,check", check=False)
    assert done.returncode == 0, done.stdout


def test_a_serial_interface_beside_ethernet_is_no_all_clear(folder):
    """Nobody said that its link type carries YAPP.  A packet of it may have one byte."""
    for data, length, code in (flight()[0][1], 48, 21), (flight()[0][1], 1, 21), (b"other bytes", 5, 0):
        packets = with_ports("udp", [(40000, 14550)], fault=None)
        uart = [(3 + at, Packet(data[at:at + length], Origin(stream_captures.USER0, 1, 0))) for at in range(0, len(data), length)]
        path = written(folder, [*packets, *uart],
                       lambda packet: packet.data if packet.origin.linktype == stream_captures.USER0 else ported(packet))
        done = tshark.run("-q", "-r", path, "-z", "yapp,faults", check=False)
        assert done.returncode == code and ("try -o yapp.user_dlt:147" in done.stderr) == (code == 21)


# docs/streams.md -------------------------------------------------------------------------------------------------

PAGE = (tshark.ROOT / "docs/streams.md").read_text()
BLOCKS = re.findall(r"(?m)(?:^    .*\n)+", PAGE)
# A command goes on behind "|", and while a text in quotes is open.
COMMANDS = [command for block in BLOCKS for command in re.findall(r"^    (?! )((?:'[^']*'|\|\n|[^'\n])+)", block, re.MULTILINE)
            if not command.startswith(("sudo", "tshark -i"))]
# The page's files, and how many messages of Motor Data each has.
FILES = {"uart.pcapng": "two_uarts_directions.pcapng", "usb.pcapng": "usbmon_cdc.pcap", "udp.pcap": "udp_bridge_40.pcap",
         "tcp.pcap": "tcp_8_byte_segments.pcap", "async.csv": "saleae_async.csv"}


def bluetooth(packet):
    """A notification of Bluetooth LE, as an HCI packet with a direction."""
    value = struct.pack("<BH", 0x1B, 0x12) + packet.data
    return struct.pack(">I", 1) + b"\2" + struct.pack("<HHHH", 0x2040, 4 + len(value), len(value), 4) + value


def test_commands_of_the_page(folder):
    """Each command finds the messages; those that do not are the two that record."""
    for name, case in FILES.items():
        shutil.copy(CASES / case, folder / name)
    data = b"".join(data for _, data in flight())
    dump = folder / "test_captures/serial/dump_document.yapp"
    dump.parent.mkdir(parents=True)
    dump.write_bytes(data)
    parts = [(0.1 * at / 48, Packet(data[at:at + 20], Origin(201, 0, 0))) for at in range(0, len(data), 20)]
    written(folder, parts, bluetooth, "ble.pcapng")
    log = (tshark.CAPTURES / "candump/candump_log_plain.log").read_text()
    (folder / "candump.log").write_text(log)
    tshark.open_to_all(folder)
    assert len(COMMANDS) == 15
    for command in COMMANDS:
        done = test_readme.shell(folder, command + " -z yapp,summary,json" * ("text2pcap" not in command))
        assert done.returncode == 0, (command, done.stderr)
        if "text2pcap" not in command:
            assert "no YAPP message found" not in done.stdout + done.stderr, command
            rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
            wanted = 6 if "async" in command else log.count("08404000#") if "candump" in command else 20
            assert sum(row["count"] for row in rows if row["id"] == MOTOR_DATA) == wanted, (command, rows)
            assert "yapp.sources" not in command or "left" in done.stdout, command
