# SPDX-License-Identifier: GPL-2.0-or-later
"""The captures of test_captures/: made from their text, shown as the text beside them says, and right by the document.

What is right is not taken from the plugin: model.py works the values out, and the tables here are typed by hand."""
import pathlib
import re
import sys

import pytest

import flights
import levels
import model
import published
import tshark
from crc32k import crc32k

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "test_captures"))
import expected  # noqa: E402
import make  # noqa: E402

pytestmark = [levels.by_route, levels.together("captures")]
NAMES = make.names()
MOTOR = bytes.fromhex("FD7FFD7FFD7FFD7FF5AFFD7F1801000001400000" "0000E38CD23CE04E000005FF")


def shown(name, passes="-2"):
    return expected.capture_shown(name, passes)


def taurus(one):
    return {name: values for name, values in one.items() if name.startswith("taurus.")}


# The files -------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("name", NAMES)
@levels.without_tshark("compares two files")
def test_the_text_makes_the_capture(name):
    path, content = make.capture(name)
    assert path.read_bytes() == content


@levels.without_tshark("of make.py alone")
def test_a_bad_crc_of_a_message_without_one():
    """A message that fits into one CAN frame has no CRC: its text asks for none that is bad."""
    assert make.Source("can0 fd [!200 00*65]\n").messages and make.Source("link pdu\n> [!0 00*7]\n").messages
    for line in "can0 [!0 00*7]", "can0 fd [!200 00*17]":
        with pytest.raises(SystemExit, match="line 1: .*fits into one CAN frame, which has no CRC: leave out the !"):
            make.Source(line)


@levels.without_tshark("of the folder alone")
def test_nothing_else_lies_there():
    top = {path.name for path in tshark.CAPTURES.iterdir() if path.is_file()}
    assert top == {"README.md", "make.py", "expected.py", "flight.py"}
    paths = [path for kind in make.KINDS for path in (tshark.CAPTURES / kind).iterdir() if not path.name.startswith("dump_")]
    assert len(paths) >= 2 * len(NAMES)
    for path in paths:
        assert path.stem in NAMES, f"{path.name} has no {path.stem}.frames"
        assert path.suffix in (".frames", ".expected", f".{make.read(path.stem).format}")
        assert (make.read(path.stem).link in make.CAN_LINKS) == (path.parent.name == "can"), path


# What is shown ---------------------------------------------------------------------------------------------------

# In a first pass of two nothing tells remote frames from data.
RUNS = [(name, passes) for name in NAMES for passes in expected.PASSES if name not in expected.SWEPT
        if (passes == "one pass" or name != "remote_frames")]


@pytest.mark.parametrize("name, passes", levels.few(RUNS, [run for run in RUNS if run[1] != "-2 -Y"], several=True))
def test_fields_and_info(name, passes):
    wanted, text = expected.comparison(name, passes, shown(name, passes))
    assert text == wanted


def wanted_of_messages(name):
    """By frame, what the messages of a text have to show: [(message, fields, experts)]."""
    by_frame = {}
    for message in make.read(name).messages:
        fields, experts = {}, []
        known = model.MESSAGES.get(message["id"])
        if known and known.least <= len(message["payload"]):
            fields, experts = model.decode(message["id"], message["payload"])
        if message["wrong_crc"]:  # a damaged message has no fault
            experts = [expert for expert in experts if expert != "taurus.fault.active"]
        by_frame.setdefault(message["frame"], []).append((message, fields, experts))
    return by_frame


LOST = {"uart_broken_off"}  # a message without its end, in front of others


@pytest.mark.parametrize("name", [name for name in NAMES if make.read(name).messages])
def test_messages_show_what_the_document_says(name):
    wanted = wanted_of_messages(name)
    frames = {one["frame"]: one for one in shown(name)}
    for number, messages in wanted.items():
        one, values = frames[number], {}
        for message, fields, experts in messages:
            for field, value in [*fields.items(), *((expert, "1") for expert in experts)]:
                values.setdefault(field, []).append(value)
        assert taurus(one) == values, f"frame {number}"
        headers = [message for message, _, _ in messages]
        if name in LOST:
            one = {field: one[field][-len(headers):] for field in one if field.startswith("yapp")}
        assert one["yapp.id"] == [f"0x{message['id']:08x}" for message in headers]
        assert one["yapp.seq"] == [str(message["seq"]) for message in headers]
        assert one["yapp.ctl"] == [str(message["ctl"]) for message in headers]
        if "yapp.crc" in one:
            assert one["yapp.crc"] == [f"0x{make.message_crc(message):08x}" for message in headers]
            assert one["yapp.crc.status"] == ["0" if message["wrong_crc"] else "1" for message in headers]
            assert one["yapp.size"] == [str(len(message["payload"])) for message in headers]


@pytest.mark.parametrize("ident", model.MESSAGES, ids=lambda ident: model.MESSAGES[ident][0])
def test_each_flag_and_each_reserved_count(folder, ident):
    """A message with each of them by itself shows what the document says, and a filter for a flag finds these alone."""
    payloads = model.sweep(ident)
    source = make.Source("".join(f"can0 fd [{ident:X} {payload.hex(' ')}]\n" for payload in payloads))
    path = folder / "sweep.pcap"
    path.write_bytes(make.pcap(source))
    wanted = [model.decode(ident, payload) for payload in payloads]
    found = {one["frame"]: one for one in expected.shown(path)}
    for message, (fields, experts) in zip(source.messages, wanted, strict=True):
        values = {name: [value] for name, value in fields.items()}
        for expert in experts:
            values.setdefault(expert, []).append("1")
        assert taurus(found[message["frame"]]) == values, message["payload"].hex()
    if any(model.is_flags(kind) for _, _, kind in model.MESSAGES[ident][2]):
        messages = [(message["frame"], fields) for message, (fields, _) in zip(source.messages, wanted)]
        assert_flags(path, ident, messages)
        with pytest.raises(AssertionError):
            assert_flags(path, ident, messages[::2])


def assert_flags(path, ident, messages):
    """Filters for flags find these alone, and the other fields of flags show what follows from the flags.

    messages  [(frame, what the fields of a message show)]"""
    flags = [name for name, kind in model.filters().items() if kind == "BOOLEAN" and name in messages[0][1]]
    tshark.assert_found(path, [(f"{name} == 1", [frame for frame, fields in messages if fields[name] == "1"]) for name in flags])
    rows = of_flags(ident, [fields for _, fields in messages])
    names = sorted({name for row in rows for name in row})
    assert {name.rpartition(".")[2] for name in names} >= {"names", "raised", "cleared"}
    shown_rows = tshark.fields(path, names, separator="|")
    found = [dict(zip(names, shown_rows[frame - 1], strict=True)) for frame, _ in messages]
    assert found == [{name: row.get(name, "") for name in names} for row in rows]


def of_flags(ident, messages):
    """What fields of flags show besides the flags, of each of some messages: { filter name: text }.

    messages  what the fields of each show"""
    rows, before = [], {}
    for fields in messages:
        row = {}
        for field, size, (group, bits) in filter(lambda row: model.is_flags(row[2]), model.MESSAGES[ident][2]):
            top = f"taurus.{model.MESSAGES[ident][0]}."
            now = int(fields[top + field], 16)
            old = before.get(field, now & ~model.MESSAGES[ident].alarms.get(field, 0))  # in a first message faults are raised
            before[field] = now
            unknown = now & ~sum(bits)
            alarms = model.MESSAGES[ident].alarms.get(field, 0)
            first = sorted(bits, key=lambda bit, alarms=alarms: not bit & alarms)  # faults stand in front
            texts = [bits[bit] for bit in first if now & bit] + [f"undefined {unknown:#x}"] * bool(unknown)
            row[f"{top}{field}.names"] = ", ".join(texts)
            of_group = {"undefined": unknown, "raised": now & ~old, "cleared": old & ~now}
            width = {"undefined": 8, "raised": 2 * size, "cleared": 2 * size}
            row |= {f"{top}{group}.{way}": f"0x{value:0{width[way]}x}" for way, value in of_group.items() if value}
        rows.append({name: text for name, text in row.items() if text})
    return rows


# The document's examples -----------------------------------------------------------------------------------------

@levels.without_tshark("of model.py alone")
def test_the_model_says_what_the_document_says():
    header = bytes.fromhex("595000001002000020000000")
    assert make.crc32k(header + MOTOR) == crc32k(header + MOTOR) == 0xC76FBEBB
    fields, experts = model.decode(model.MOTOR, MOTOR)
    assert model.value(45045, 2, -128, 128) == pytest.approx(47.97, abs=0.005)
    assert fields["taurus.motor.timestamp"] == "86725.000072419" and experts == ["taurus.value.special"]
    assert [model.value(count, 2, -10, 5) for count in (0, 65530)] == [-10, 5]
    assert model.value(43687, 2, -10, 5) == pytest.approx(0, abs=15 / 65530)


# What a user sees ------------------------------------------------------------------------------------------------

COLUMNS = {"Protocol": "%p", "Source": "%s", "Info": "%i"}
SHOWN = {"document_motor": {"Protocol": "YAPP", "Source": "0x210", "Info": "Motor Data  0.0/0.0 RPM  47.97 V  0.00 A"},
         "document_udp": {"Protocol": "YAPP", "Source": "192.0.2.1"},  # of the packet
         "document_tcp": {"Protocol": "YAPP"},
         "uart_shell": {"Source": "0x210"},  # of its first message
         "document_uart": {"Protocol": "YAPP", "Source": "0x210", "Info": "Motor Data  0.0/0.0 RPM  47.97 V  0.00 A"}}


@levels.by_version
@levels.each_once
@pytest.mark.parametrize("arguments", [(), ("-2",), ("-P", "-V"), ("-2", "-P", "-q", "-z", "io,phs"), ("-T", "psml")],
                         ids=" ".join)
@pytest.mark.parametrize("name", SHOWN)
def test_every_column_wherever_it_is_printed(name, arguments):
    """tshark has no columns with -V, -q and in a first pass of two; then no text is made for them."""
    columns = ",".join(f'"{title}","{COLUMNS[title]}"' for title in SHOWN[name])
    printed = tshark.run("-r", make.capture(name)[0], *arguments, "-o", f"gui.column.format:{columns}").stdout
    texts = r" *(?:</section>\s*<section>| )".join(map(re.escape, SHOWN[name].values()))
    assert re.search(rf"(?m)^ *(<section>)?{texts} *(</section>)?$", printed), printed


@levels.by_version
@pytest.mark.parametrize("name", ["serial/dump_document.yapp", "serial/document_uart_split.pcap", "can/document_motor.pcap",
                                  "can/unknown_id.pcap"])
def test_protocols_are_counted_whatever_else_is_wanted(name):
    """Packets of skipped bytes, and of bytes that wait, are YAPP's where a filter names fields of Taurus alone; Taurus' are those
    with values.  Each counts once."""
    counted = [re.findall(r"\n +(yapp|taurus) +frames:(\d+)", tshark.run("-q", "-r", tshark.CAPTURES / name, "-z", "io,phs", *filters).stdout)
               for filters in ((), ("-Y", "taurus || frame"))]
    protocols = ["yapp"] if name == "can/unknown_id.pcap" else ["yapp", "taurus"]
    assert counted[0] == counted[1] and [protocol for protocol, _ in counted[0]] == protocols


@levels.by_version
def test_bytes_of_a_message_in_filters():
    """They are asked of the tree's bytes, where nothing else is wanted of it and no tree is shown."""
    path = tshark.CAPTURES / "can/document_motor.pcap"
    raw = [] if tshark.version() < (4, 2) else [("@taurus.motor.dc_voltage == f5:af", [5]), ("@taurus.motor.dc_voltage == f5:ae", [])]
    rows = [("taurus contains 18:01:00:00", [5]), ("taurus contains 18:01:00:02", []), (r'taurus[12:1] == "\x18"', [5]),
            (r'taurus[12:1] == "\x19"', []), ("taurus[30:2] == 05:ff", [5]), ("len(taurus) == 32", [5]), ("len(taurus) == 31", []), *raw]
    tshark.assert_found(path, rows)
    found = tshark.run("-r", path, "-Y", rows[0][0]).stdout  # a filter alone
    assert [line.split()[0] for line in found.splitlines()] == ["5"]


def test_what_an_unknown_id_is_like(folder):
    """By its size; a display filter finds the ID."""
    path, messages = folder / "like.pcap", list(enumerate(model.MESSAGES.items(), 0x123))
    path.write_bytes(make.pcap(make.Source("".join(f"can0 [{like:x} {bytes(one.size).hex()}]\n" for like, (_, one) in messages) * 2)))
    rows = tshark.fields(path, [f"yapp.like.{one.name}" for _, (_, one) in messages], "-o", "yapp.all_extended:TRUE")
    assert [row for row in rows if any(row)] == [[f"{like:#010x}" * (like == own) for own, _ in messages] for like, _ in messages] * 2
    shown = tshark.run("-r", path, "-o", "yapp.all_extended:TRUE", "-o", 'gui.column.format:"Info","%i"', "-Y", "yapp.id.unknown").stdout
    texts = [f"ID {like:#x}  {one.size} bytes, the size of {one[1]}" for like, (_, one) in messages]
    assert [line.strip().split("  [copy of")[0] for line in shown.splitlines()] == texts * 2
    ids = [word for like, (ident, one) in messages for word in ("-o", f"yapp.{one.name}_ids:{ident},{like:#x}")]
    assert all(map(any, zip(*tshark.fields(path, [f"taurus.{one.name}" for _, (_, one) in messages], *ids))))


def test_rounded_values(folder):
    """Of each message, where no tree is printed: those of its fields, with fewer digits."""
    names = [name.removesuffix(".rounded") for name in published.of("field") if name.endswith(".rounded")]
    flight = flights.make(3)
    path, columns = flight.write(folder / "run.pcapng", "pcapng"), [f'"{name}","%Cus:{name}.rounded:0:R"' for name in names]
    options = flight.arguments("pcapng")
    shown = tshark.run("-r", path, *options, "-o", f"gui.column.format:{','.join(columns)}", "-T", "psml").stdout
    cells = [re.findall(r"<section>(.*?)</section>", row) for row in shown.split("<packet>")[1:]]
    rows = list(zip(tshark.fields(path, names, *options), cells, strict=True))
    seen = {name: [(exact[at], cell[at]) for exact, cell in rows if exact[at] or cell[at]] for at, name in enumerate(names)}
    assert names and all(seen.values()), [name for name, pairs in seen.items() if not pairs]
    for name, pairs in seen.items():
        for exact, cell in pairs:
            unit = 10 ** -len(cell.partition(".")[2]) if "." in cell else 1
            assert abs(float(cell) - float(exact)) <= unit / 2 + 1e-9, (name, exact, cell)


def test_no_rounded_zero_is_negative(folder):
    """The count below that of 0 A is -0.004 A."""
    path, name = folder / "zero.pcap", "taurus.motor.dc_current"
    path.write_bytes(make.pcap(make.Source(f"can0 fd [210 {(bytes([0xFC, 0x7F]) * 6 + bytes(20)).hex(' ')}]\n")))
    assert -0.005 < float(tshark.fields(path, [name])[0][0]) < 0
    shown = tshark.run("-r", path, "-o", f'gui.column.format:"{name}","%Cus:{name}.rounded:0:R"').stdout
    assert shown.split() == ["0"]


# Capture, frame, field, and how the tree reads.
TREE = [
    ("document_motor", 5, "taurus.motor.dc_voltage", "DC Voltage: 47.97314 V"),
    ("document_motor", 5, "taurus.motor.dc_current", "DC Current: 0 A"),
    ("document_motor", 5, "taurus.motor.motor_temperature", "Motor Temperature: -16 °C"),
    ("document_motor", 5, "taurus.motor.motor_mode", "Motor Mode: Speed Mode (0x01)"),
    ("document_motor", 5, "taurus.motor.esc_temperature.special", "ESC Temperature: Not a Number (0)"),
    ("document_motor", 5, "taurus.motor.motor_state", "Motor State: 0x05 (ready, stopped)"),
    ("document_motor", 5, "yapp.crc", "CRC: 0xc76fbebb"),
    ("document_motor", 5, "yapp.crc.status", "CRC status: Good (1)"),
    ("document_motor", 5, "yapp.id", "Message ID: Motor Data (0x00000210)"),
    ("document_motor", 5, "yapp.can.ctrl", "CAN frame: End (3)"),
    ("document_motor", 5, "yapp.size", "Payload size: 32"),
    ("document_motor", 5, "taurus.motor.rpm_error", "RPM Error: 0 RPM"),
    ("document_motor", 5, "taurus.motor.dc_power", "DC Power: 0 W"),
    ("document_command", 1, "taurus.command.torque_iq", "Torque IQ: 0.5005341 A"),
    ("document_command", 1, "taurus.command.rpm", "RPM: 750.8012 RPM"),
    ("document_command", 1, "taurus.command.key", "Key: No Regeneration Allowed (0x5a)"),
    ("document_command", 1, "taurus.command.enabled", "Enabled: Enabled (0x01)"),
    ("health", 4, "taurus.health.control_thread_cpu", "Control Thread CPU Usage: 50 %"),
    ("health", 4, "taurus.health.vin_rms_ripple", "Vin RMS Ripple: 1.25 V"),
    *((name, number, "yapp", f"Yet Another Packet Protocol, {text}") for name, number, text in [
        ("document_command", 1, "Command, Single"), ("document_motor", 1, "Motor Data, Start"),
        ("document_motor", 2, "Motor Data, Middle"), ("document_motor", 5, "Motor Data, End, CRC good"),
        ("bad_crc_can", 5, "Motor Data, End, CRC BAD"), ("bad_crc_uart", 1, "Motor Data, CRC BAD"),
        ("cut_end", 5, "Motor Data, End, CRC unverified"), ("cut_start", 5, "Motor Data, End"),
        ("cut_uart", 1, "Motor Data, incomplete"), ("ctrl_4_to_15", 1, "Motor Data, undefined frame"),
        ("unknown_id", 1, "ID 0x123, Single"), ("uart_several", 2, "3 bytes skipped"),
    ]),
]


@pytest.mark.parametrize("name", sorted({row[0] for row in TREE}))
def test_tree(name):
    """Among others, beside which a controller has its name in it."""
    for _, number, field, text in [row for row in TREE if row[0] == name]:
        found = [one.get("showname") or one.get("show") for one in expected.trees(name)[number - 1].iter() if one.get("name") == field]
        assert [expected.NAMED_SOURCE.sub("", one) if field == "yapp" else one for one in found] == [text]


# Capture and the protocols of its last packet.
PROTOCOLS = {
    "document_motor": "can:yapp", "document_command": "can:yapp",
    "document_motor_sll2": "sll:can:yapp", "fd_single": "can:yapp", "document_uart": "exported_pdu:yapp_serial", "document_uart_dlt_user0":
    "user_dlt:yapp_serial", "document_uart_rtac": "rtacser:yapp_serial",
    "document_udp": "eth:ethertype:ip:udp:yapp_serial", "document_tcp": "eth:ethertype:ip:yapp_tcp:tcp:yapp_serial",
}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_protocols(name):
    shown = [one.get("show") for one in expected.trees(name)[-1].iter("field") if one.get("name") == "frame.protocols"]
    assert shown == [PROTOCOLS[name]]
