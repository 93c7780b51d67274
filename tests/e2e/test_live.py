# SPDX-License-Identifier: GPL-2.0-or-later
"""Live ports: extcap/yapp_extcap.py on a pseudo terminal, and CAN on python-can's virtual bus; by itself, and under the real
tshark.  Every byte that is written comes out, in order; and whatever ends a capture is said."""
import contextlib
import fcntl
import fnmatch
import glob
import importlib
import os
import pathlib
import pty
import random
import re
import shutil
import signal
import stat
import struct
import subprocess
import sys
import termios
import threading
import time
import tty
import types

import flights
import pytest
import levels
import tshark

pytestmark = levels.without_tshark("of the live ports, most of which run no tshark")

EXTCAP = tshark.ROOT / "extcap/yapp_extcap.py"
# YAPP_PYTHON: one with python-can and pyserial, where the system's has none.
PYTHON = os.environ.get("YAPP_PYTHON") or ("/usr/bin/python3" if os.path.exists("/usr/bin/python3") else sys.executable)
FRAME = bytes.fromhex("5950000010020000 20000000 FD7FFD7FFD7FFD7FF5AFFD7F1801 00000140 00000000 E38CD23CE04E0000 05FF BBBE6FC7")


def spoken(*arguments):
    """What the extcap answers."""
    done = subprocess.run([PYTHON, EXTCAP, *arguments], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


class Port:
    """A pseudo terminal: the name that a program opens, and the far end."""

    def __init__(self):
        try:
            self.far, near = pty.openpty()
        except OSError as problem:
            pytest.skip(f"no pseudo terminals here: {problem}")
        self.name = os.ttyname(near)
        tty.setraw(near)
        user = tshark._user()
        if user:
            os.chown(self.name, user["user"], user["group"])
        self.near = near

    def wait_until_open(self, baud=termios.B500000):
        deadline = time.monotonic() + 60
        while termios.tcgetattr(self.near)[5] != baud:
            assert time.monotonic() < deadline, "nobody opened the port"
            time.sleep(0.02)

    def write(self, data):
        while data:
            data = data[os.write(self.far, data):]

    def unplug(self):
        os.close(self.near)
        os.close(self.far)
        self.far = self.near = None

    def close(self):
        if self.far is not None:
            self.unplug()


@pytest.fixture
def port():
    port = Port()
    yield port
    port.close()


second = port


def options_of(body, at):
    """The options of a block: (code, value)."""
    while at < len(body):
        code, size = struct.unpack_from("=HH", body, at)
        yield code, body[at + 4:at + 4 + size]
        at += 4 + (size + 3) // 4 * 4


class Pcapng:
    """What a capture has: interfaces [(link type, name)], packets [(interface, seconds, data, direction)], dropped [count]."""

    def __init__(self, data):
        self.interfaces, self.packets, self.dropped, at = [], [], [], 0
        while at + 12 <= len(data) and at + struct.unpack_from("=I", data, at + 4)[0] <= len(data):
            kind, size = struct.unpack_from("=II", data, at)
            body, at = data[at + 8:at + size - 4], at + size
            if kind == 1:
                values = dict(options_of(body, 8))
                assert values[9] == b"\x09"
                self.interfaces.append((struct.unpack_from("=H", body)[0], values[2].decode()))
            elif kind == 6:
                interface, high, low, size, whole = struct.unpack_from("=5I", body)
                assert size == whole
                options = dict(options_of(body, 20 + (size + 3) // 4 * 4))
                flags = options.get(2, bytes(4))
                self.dropped += struct.unpack("=Q", options[4]) if 4 in options else ()
                self.packets.append((interface, ((high << 32) + low) / 1e9, body[20:20 + size], flags[0] & 3))

    def bytes_of(self, interface=0):
        """What came on a serial port: the packets' data behind the name of the dissector."""
        prefix = struct.pack(">HH", 12, 12) + b"yapp_serial\0" + bytes(4)
        data = [packet[2] for packet in self.packets if packet[0] == interface]
        assert all(packet.startswith(prefix) for packet in data)
        return b"".join(packet[len(prefix):] for packet in data)


class Extcap:
    """The extcap alone, started as Wireshark does; its fifo is read by a thread."""

    def __init__(self, folder, *arguments, interface="yapp-serial", program=EXTCAP, start=True):
        self.fifo = folder / f"fifo{random.random()}"
        os.mkfifo(self.fifo)
        self.data, self.reader = b"", None
        self.process = subprocess.Popen([PYTHON, program, "--capture", "--extcap-interface", interface, "--fifo", self.fifo,
                                         *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        threading.Thread(target=self._release, daemon=True).start()
        self.file = open(self.fifo, "rb", buffering=0)
        if start:
            self.read()

    def _release(self):
        """Nobody waits for a program that ends before it opens the fifo."""
        self.process.wait()
        with contextlib.suppress(FileNotFoundError):  # the folder is gone where it ended later
            os.close(os.open(self.fifo, os.O_RDWR | os.O_NONBLOCK))

    def read(self):
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        while True:
            more = self.file.read(1 << 16)
            if not more:
                return
            self.data += more

    def end(self, how=signal.SIGTERM, code=0, timeout=60):
        """Ends it, or waits for its end; returns what was captured, and what it said."""
        if how:
            self.process.send_signal(how)
        out, errors = self.process.communicate(timeout=timeout)
        assert (self.process.returncode, out) == (code, ""), errors
        if self.reader:
            self.reader.join(5)
        return Pcapng(self.data), errors


def wait_for(condition, seconds=60):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


# The contract ---------------------------------------------------------------------------------------------------------

SETTINGS = {"yapp-serial": {"port": None, "baud": "500000", "parity": "none", "stopbits": "1", "second": "none"},
            "yapp-can": {"adapter": None, "channel": None, "bitrate": "1000000", "fd": "false", "data-bitrate": "5000000"}}
DOCUMENT = (tshark.ROOT / "docs/live.md").read_text()


@pytest.mark.parametrize("interface", SETTINGS)
def test_settings(interface):
    """As Wireshark reads them, with the document's defaults.  docs/live.md has them by the names of their preferences, which have
    no hyphens: extcap.yapp_can.databitrate."""
    out = spoken("--extcap-interfaces", "--extcap-version=4.4")
    assert out.startswith(f"extcap {{version={tshark.plugin_version()}}}") and "interface {value=yapp-serial}{display=YAPP serial port}" in out
    out = spoken("--extcap-config", "--extcap-interface", interface)
    lines = [re.fullmatch(r"(arg|value) ((?:\{\w+=[^{}]+\})+)", line).groups() for line in out.splitlines()]
    rows = [(kind, dict(re.findall(r"\{(\w+)=([^{}]+)\}", text))) for kind, text in lines]
    defaults = {row["number"]: row.get("default") for kind, row in rows if kind == "arg"}
    defaults |= {row["arg"]: row["value"] for kind, row in rows if kind == "value" and row.get("default") == "true"}
    calls = {row["call"].removeprefix("--"): defaults[row["number"]] for kind, row in rows if kind == "arg"}
    assert calls == SETTINGS[interface]
    names = {call.replace("-", "") for call in calls}
    named = set(re.findall(rf"extcap\.{interface.replace('-', '_')}\.(\w+):", DOCUMENT))
    assert named and named <= names and all(f"`{name}`" in DOCUMENT for name in names)
    adapters = {row["value"] for kind, row in rows if kind == "value"}
    if interface == "yapp-can":
        assert len(adapters) >= 12 and adapters <= set(pytest.importorskip("can", reason="no python-can").VALID_INTERFACES)


def test_which_ports_there_are(extcap, monkeypatch):
    """Adapters, the UARTs of single-board computers, Bluetooth, macOS's; of what /dev has no more."""
    ports = ["/dev/" + name for name in ("cu.usbserial-1", "rfcomm0", "ttyACM0", "ttyAMA0", "ttyTHS1", "ttyUSB0", "ttymxc2")]
    there = [*ports, "/dev/tty0", "/dev/tty.usbserial-1", "/dev/console", "/dev/null"]
    monkeypatch.setattr(glob, "glob", lambda pattern: fnmatch.filter(there, pattern))
    assert extcap.serial_ports() == ports


# A serial port --------------------------------------------------------------------------------------------------------

def test_frames_with_pauses_are_packets_and_not_held_back(folder, port):
    """Each comes without the next one, with the time at which it came."""
    extcap = Extcap(folder, "--port", port.name)
    port.wait_until_open()
    limits = []
    for count in range(1, 21):
        begin = time.time()
        port.write(FRAME)
        wait_for(lambda: extcap.data.count(FRAME) == count)
        limits.append((begin, time.time()))
    capture, _ = extcap.end()
    assert len(capture.packets) == 20
    for packet, (begin, end) in zip(capture.packets, limits):
        assert begin - 0.001 <= packet[1] <= end + 0.001


@pytest.fixture
def extcap(monkeypatch):
    """The program as a module: what it asks of a driver is kept by a stand-in."""
    monkeypatch.syspath_prepend(str(EXTCAP.parent))
    monkeypatch.delitem(sys.modules, "yapp_extcap", raising=False)
    return importlib.import_module("yapp_extcap")


def settings(extcap, interface, **values):
    """As Wireshark gives them."""
    options = extcap.parse([word for name, value in values.items() for word in (f"--{name}={value}",)])
    extcap.read_settings(extcap.INTERFACES[interface], options)
    options.stop = threading.Event()
    return options


EIGHT = termios.CS8 | termios.CREAD | termios.CLOCAL
LINES = [("none", "1", 0), ("even", "1", termios.PARENB), ("odd", "1", termios.PARENB | termios.PARODD), ("none", "2", termios.CSTOPB)]


@pytest.mark.parametrize("parity, stopbits, flags", LINES)
def test_what_a_line_is_set_to(extcap, monkeypatch, port, parity, stopbits, flags):
    """Raw, without flow control: a pseudo terminal forgets the parity.  What came before it was set so is no data."""
    asked, dropped = [], []
    monkeypatch.setattr(termios, "tcflush", lambda _, queue: dropped.append(queue))
    monkeypatch.setattr(termios, "tcsetattr", lambda _, when, attributes: asked.append((when, attributes)))
    extcap.set_line(port.near, port.name, settings(extcap, "yapp-serial", baud="115200", parity=parity, stopbits=stopbits))
    [(when, (inputs, outputs, control, local, *rates, characters))] = asked
    assert dropped == [termios.TCIFLUSH]
    assert (when, inputs, outputs, local, rates) == (termios.TCSANOW, 0, 0, 0, [termios.B115200] * 2)
    assert control == EIGHT | flags and characters[termios.VMIN] == 1 and characters[termios.VTIME] == 0


# What python-can receives, and its SocketCAN record.
USUAL = {"arbitration_id": 0x123, "is_extended_id": True, "dlc": 1, "data": b"A", "is_remote_frame": False, "is_error_frame": False,
         "is_fd": False, "bitrate_switch": False, "error_state_indicator": False}
RECORDS = [({}, "80000123 01 000000 41"), ({"is_extended_id": False, "dlc": 2, "data": b"12"}, "00000123 02 000000 3132"),
           ({"is_remote_frame": True, "dlc": 4, "data": b""}, "C0000123 04 000000"),
           ({"is_fd": True, "bitrate_switch": True, "error_state_indicator": True, "dlc": 64, "data": bytes(64)}, "80000123 40 070000" + "00" * 64),
           ({"is_error_frame": True, "arbitration_id": 8, "dlc": 8, "data": bytes(8)}, "A0000008 08 000000" + "00" * 8)]


@pytest.mark.parametrize("fd, more", [("false", {}), ("true", {"fd": True, "data_bitrate": 2_000_000})])
def test_what_an_adapter_is_asked_for(extcap, monkeypatch, fd, more):
    """And the time of a frame: the adapter's, if it counts from 1970.  At the end it is given back."""
    asked, times = [], [1_700_000_000.25, *[12.5] * len(RECORDS)]
    sent = [types.SimpleNamespace(**USUAL | values) for values, _ in RECORDS]

    class Bus:
        def __init__(self, **arguments):
            asked.append(arguments)

        def recv(self, _):
            sent[0].timestamp = times.pop(0)
            return sent.pop(0)

        def shutdown(self):
            asked.append("shutdown")

    monkeypatch.setitem(sys.modules, "can", types.SimpleNamespace(Bus=Bus))
    options = settings(extcap, "yapp-can", adapter="pcan", channel="PCAN_USBBUS1", bitrate="250000", fd=fd, **{"data-bitrate": "2000000"})
    frames = extcap.can_frames(options)
    assert next(frames) is None and asked == [{"interface": "pcan", "channel": "PCAN_USBBUS1", "bitrate": 250_000, **more}]
    found = [next(frames) for _ in RECORDS]
    assert abs(found[0][0] - 1_700_000_000_250_000_000) < 1000 and all(abs(at - time.time_ns()) < 60e9 for at, _ in found[1:])
    assert [data for _, data in found] == [bytes.fromhex(text) for _, text in RECORDS]
    options.stop.set()
    assert list(frames) == [] and asked[1:] == ["shutdown"]


SPEED = 300_000  # bytes a second: 3 Mbaud


def pour(port, seconds):
    """Writes at 3 Mbaud; returns what was written."""
    data = (FRAME * 1000)[:SPEED // 100]
    begin = time.monotonic()
    for count in range(round(seconds * 100)):
        port.write(data)
        time.sleep(max(0, begin + (count + 1) / 100 - time.monotonic()))
    return data * round(seconds * 100)


# What ends a capture ---------------------------------------------------------------------------------------------------

def refused(folder, *arguments):
    """What it says when it cannot begin; its fifo is a capture without packets all the same."""
    capture, errors = Extcap(folder, *arguments).end(how=None, code=1)
    assert capture.packets == [] and len(capture.interfaces) >= 1
    assert errors.startswith("YAPP: ") and errors.count("\n") == 1
    return errors


@pytest.mark.parametrize("arguments, said", [
    ("", "no port was chosen"), ("--port /dev/ttyNOPE", "there is no port /dev/ttyNOPE"),
    ("--port /dev/null", "/dev/null is not a serial port"), ("--port /etc/passwd", "/etc/passwd is not a serial port"),
    ("--port PORT --baud fast", "baud rate: a number from 50 to 20000000, not 'fast'"),
    ("--port PORT --parity mark", "parity: none, even or odd, not 'mark'"), ("--port PORT --stopbits 3", "stop bits: 1 or 2, not '3'"),
    ("--port PORT --second PORT", "is both ports")])
def test_what_is_refused(folder, port, arguments, said):
    assert said in refused(folder, *arguments.replace("PORT", port.name).split())


def test_busy_port(folder, port):
    first = Extcap(folder, "--port", port.name)
    port.wait_until_open()
    assert f"{port.name} is in use by another program" in refused(folder, "--port", port.name)
    first.end()


def refused_to_nobody(folder, port):
    """What it says to an ordinary user."""
    os.chmod(folder, 0o777)
    os.mkfifo(folder / "fifo")
    os.chmod(folder / "fifo", 0o666)
    shutil.copy(EXTCAP, folder / "extcap.py")
    nobody = {"user": 65534, "group": 65534, "extra_groups": []} if os.geteuid() == 0 else {}
    process = subprocess.Popen(["/usr/bin/python3", folder / "extcap.py", "--capture", "--extcap-interface", "yapp-serial", "--port",
                                port.name, "--fifo", folder / "fifo"], stderr=subprocess.PIPE, text=True, **nobody)
    (folder / "fifo").read_bytes()
    return process.communicate(timeout=60)[1]


def test_a_port_that_the_kernel_keeps_for_another(folder, port):
    os.chmod(port.name, 0o666)
    fcntl.ioctl(port.near, termios.TIOCEXCL)
    errors = refused_to_nobody(folder, port)
    assert errors == f"YAPP: {port.name} is in use by another program: close that one, then start again\n"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become somebody else")
@pytest.mark.parametrize("group, mode, advice", [
    (20, 0o660, r"belongs to the group (\w+): sudo usermod -aG \1 \$USER"),
    (20, 0o600, r"sudo chown \$USER /dev"),  # the group may not, either
    (0, 0o660, r"sudo chown \$USER /dev"),  # nobody is to join the group of root
])
def test_port_of_somebody_else(folder, port, group, mode, advice):
    os.chown(port.name, 0, group)
    os.chmod(port.name, mode)
    errors = refused_to_nobody(folder, port)
    assert re.search(advice, errors) and "root" not in errors
    assert stat.S_IMODE(os.stat(port.name).st_mode) == mode


def queued(port):
    """Bytes that the port has and nobody has read."""
    return struct.unpack("i", fcntl.ioctl(port.near, termios.FIONREAD, bytes(4)))[0]


def test_a_slow_reader_costs_no_memory(folder, port):
    """Packets beyond the limit are dropped, and the next packet says how many."""
    program = folder / "small.py"
    program.write_text(f"import os, sys\nsys.path.insert(0, {str(EXTCAP.parent)!r})\nimport yapp_extcap\n"
                       "yapp_extcap.MAX_WAITING = 20000\nos._exit(yapp_extcap.main())\n")
    extcap = Extcap(folder, "--port", port.name, program=program, start=False)
    port.wait_until_open()
    for _ in range(60):
        port.write(FRAME * 60)
        wait_for(lambda: not queued(port))
    extcap.read()
    wait_for(lambda: port.write(b"later") or b"later" in extcap.data)
    capture, errors = extcap.end()
    assert sum(capture.dropped) > 0 and len(extcap.data) < 60 * 60 * len(FRAME)
    assert f"{sum(capture.dropped)} packets are not in the capture" in errors


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("busy", [False, True])
def test_signals_end_it(folder, port, how, busy):
    extcap = Extcap(folder, "--port", port.name)
    port.wait_until_open()
    port.write(FRAME)
    wait_for(lambda: FRAME in extcap.data)
    if busy:
        threading.Thread(target=lambda: [port.write(FRAME) for _ in range(50)], daemon=True).start()
    capture, errors = extcap.end(how)
    assert errors == "" and capture.packets
    assert (FRAME * 51).startswith(capture.bytes_of())


@pytest.mark.parametrize("busy", [False, True])
def test_a_closed_fifo_ends_it(folder, port, busy):
    extcap = Extcap(folder, "--port", port.name, start=False)
    extcap.file.read(100)
    port.wait_until_open()
    extcap.file.close()
    if busy:
        port.write(FRAME)
    _, errors = extcap.end(how=None)
    assert errors == ""


# Under tshark ---------------------------------------------------------------------------------------------------------

@pytest.fixture
def home(folder):
    """A home with the extcap where this Wireshark looks; and with the plugin where that is how it is loaded."""
    home = folder / "home"
    if tshark.ROUTE == "plugin":
        tshark.install_plugin(home / tshark.PERSONAL_FOLDER / "yapp")
    for name in (".config/wireshark/extcap", ".local/lib/wireshark/extcap"):
        (home / name).mkdir(parents=True)
        shutil.copy(EXTCAP, home / name)
    return tshark.open_to_all(home)


def run_tshark(home, *arguments):
    environment = {**os.environ, "HOME": str(home), "LC_ALL": "C.UTF-8"}
    environment.pop("XDG_CONFIG_HOME", None)
    return subprocess.Popen(["tshark", *map(str, arguments)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True, stdin=subprocess.DEVNULL, **tshark._user())


def ends(process, timeout=60):
    out, errors = process.communicate(timeout=timeout)
    assert "Lua:" not in errors
    return out, errors


def test_tshark_keeps_every_byte(home, folder, port, second):
    path = folder / "live.pcapng"
    process = run_tshark(home, "-q", "-i", "yapp-serial", "-o", f"extcap.yapp_serial.port:{port.name}", "-o",
                         f"extcap.yapp_serial.second:{second.name}", "-o", "extcap.yapp_serial.baud:3000000", "-w", path)
    port.wait_until_open(termios.B3000000)
    second.wait_until_open(termios.B3000000)
    other = threading.Thread(target=lambda: pour(second, 2))
    other.start()
    sent = pour(port, 2)
    other.join()

    def size():
        capture = Pcapng(path.read_bytes())
        return len(capture.bytes_of(0)) + len(capture.bytes_of(1))

    wait_for(lambda: size() == 2 * len(sent))
    process.send_signal(signal.SIGINT)
    ends(process)
    capture = Pcapng(path.read_bytes())
    assert capture.interfaces == [(252, port.name), (252, second.name)]
    assert capture.bytes_of(0) == sent and capture.bytes_of(1) == sent
    assert {(packet[0], packet[3]) for packet in capture.packets} == {(0, 1), (1, 2)}  # the directions
    shown = tshark.fields(path, ["frame.interface_id", "yapp.crc.status"], "-c", "20")
    assert {row[0] for row in shown} == {"0", "1"} and all(set(row[1]) <= {"1", ","} for row in shown)


def opened_captures():
    """The temporary captures that a tshark of this test has opened and begun to read."""
    found = []
    for process in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):  # processes and files come and go
            if int((process / "stat").read_text().rpartition(")")[2].split()[1]) != os.getpid():
                continue
            for path in (process / "fd").iterdir():
                position = int((process / "fdinfo" / path.name).read_text().split()[1])
                if os.readlink(path).endswith(".pcapng") and position > 0:
                    found.append(path)
    return found


def pour_blocks(data, blocks, pipe):
    """Writes a pcapng file; its first blocks, and the others when tshark has opened what there is of it."""
    at = 0
    for _ in range(blocks):
        at += int.from_bytes(data[at + 4:at + 8], "little")
    with open(pipe, "wb") as file:
        file.write(data[:at])
        file.flush()
        wait_for(opened_captures)
        time.sleep(0.1)  # read_open of the plugin reads in the same microseconds
        file.write(data[at:])


def poured(path, blocks, *arguments, check=True):
    """Captures a file live: its first blocks are there when tshark opens the capture."""
    read_end, write_end = os.pipe()
    writer = threading.Thread(target=pour_blocks, args=(path.read_bytes(), blocks, write_end))
    writer.start()
    with open(read_end, "rb") as pipe:
        live = tshark.run("-i", "-", *arguments, stdin=pipe, check=check)
    writer.join()
    return live


@pytest.mark.parametrize("form, blocks", [("pcapng", 2), ("sll2", 1)])
def test_buses_that_show_after_the_capture_was_opened(folder, form, blocks):
    flight, path = flights.make(103), folder / "flight.pcapng"
    assert len(flight.names) > 1
    flight.write(path, form)
    arguments = ["-n", "-t", "r", *flight.arguments(form)]
    assert poured(path, blocks, *arguments).stdout == tshark.run("-r", path, *arguments).stdout


def test_an_interface_whose_packets_come_after_the_capture_was_opened():
    """CAN beside IEEE 1722, on which the same Commands go on: those on can0 stop, or nothing tells it."""
    path = tshark.CAPTURES / "cases" / "c2_silence_masked.pcapng"
    for blocks in (3, 4, 5):  # no packet, one or two, of can0
        assert poured(path, blocks, "-q", "-z", "yapp,check,silence=0", check=False).returncode in (20, 21)


def test_tshark_and_a_port_that_goes(home, port):
    process = run_tshark(home, *tshark.load(), "-i", "yapp-serial", "-o", f"extcap.yapp_serial.port:{port.name}", "-l", "-T",
                         "fields", "-e", "taurus.motor.dc_voltage")
    port.wait_until_open()
    port.write(FRAME)
    assert process.stdout.readline() == "47.97314\n"
    port.unplug()
    out, errors = ends(process)
    assert out == "" and f"{port.name} is gone" in errors


@pytest.mark.parametrize("command", re.findall(r"^    tshark -i yapp-serial (.*)", DOCUMENT, re.MULTILINE))
def test_commands_of_the_document(home, folder, port, second, command):
    for name, there in (("/dev/ttyUSB0", port.name), ("/dev/ttyUSB1", second.name), ("both.pcapng", folder / "both.pcapng")):
        command = command.replace(name, str(there))
    process = run_tshark(home, *tshark.load(), "-l", "-i", "yapp-serial", *command.split())
    baud = re.search(r"baud:(\d+)", command)
    port.wait_until_open(getattr(termios, f"B{baud[1]}" if baud else "B500000"))
    port.write(FRAME[:42] + FRAME)  # the first is cut off
    both = folder / "both.pcapng"
    if "both" in command:
        wait_for(lambda: both.exists() and FRAME in both.read_bytes())
    else:
        wait_for(lambda: any(FRAME in path.read_bytes() for path in opened_captures()))
    process.send_signal(signal.SIGINT)
    out, errors = ends(process)
    assert "captured" in errors
    if "both" in command:
        assert both.read_bytes().count(FRAME) == 1
    else:
        assert ("Motor Data" in out) == ("fault.active" not in command)


# CAN, and pyserial ----------------------------------------------------------------------------------------------------

def test_can_that_is_not_there(folder):
    extcap = Extcap(folder, "--adapter", "nonsense", "--channel", "x", interface="yapp-can")
    assert "nonsense x cannot be opened" in extcap.end(how=None, code=1)[1]
    assert "no adapter was chosen" in Extcap(folder, interface="yapp-can").end(how=None, code=1)[1]


def test_the_way_of_windows(folder, port):
    """pyserial, on the same pseudo terminal."""
    program = folder / "windows.py"
    program.write_text(f"import os, sys\nsys.path.insert(0, {str(EXTCAP.parent)!r})\nimport yapp_extcap\n"
                       "yapp_extcap.open_by_termios = yapp_extcap.open_by_pyserial\nos._exit(yapp_extcap.main())\n")
    extcap = Extcap(folder, "--port", port.name, program=program)
    port.wait_until_open()
    for count in range(1, 11):
        port.write(FRAME)
        wait_for(lambda: extcap.data.count(FRAME) == count)
    capture, errors = extcap.end()
    assert errors == "" and len(capture.packets) == 10 and capture.bytes_of() == FRAME * 10
    extcap = Extcap(folder, "--port", "/dev/ttyNOPE", program=program)
    assert "/dev/ttyNOPE cannot be opened" in extcap.end(how=None, code=1)[1]
