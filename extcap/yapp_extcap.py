#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Live ports for Wireshark (an extcap): a serial port that carries YAPP, and CAN adapters that python-can knows.

Wireshark runs this file by itself, once it lies in the extcap folder; docs/live.md says how to use it.  By hand:

    tshark -i yapp-serial -o extcap.yapp_serial.port:/dev/ttyUSB0
    tshark -i yapp-can -o extcap.yapp_can.adapter:pcan -o extcap.yapp_can.channel:PCAN_USBBUS1

Python 3.7 or later.  Serial ports need nothing else on Linux and macOS, and pyserial on Windows; CAN needs python-can.
"""
import argparse
import collections
import contextlib
import glob
import importlib.util
import os
import queue
import select
import shutil
import signal
import struct
import sys
import threading
import time

try:
    import fcntl
    import termios
except ImportError:  # Windows
    termios = None

VERSION = "3.0.0"
PAUSE = 0.002  # seconds: bytes with no longer pause between them are one packet,
LONGEST = 0.02  # of no more seconds than this,
LARGEST = 4096  # and no more bytes
EXPORTED_PDU = struct.pack(">HH", 12, 12) + b"yapp_serial\0" + bytes(4)  # the dissector's name, in front of its bytes
WAIT = 0.2  # seconds, after which a source looks whether it is to stop
STUCK = 2  # seconds in which a reader that is not stuck reads a packet
MAX_WAITING = 1 << 25  # bytes that a reader may be behind: 100 s of the fastest serial line


class Problem(Exception):
    """What ends a capture, as a sentence that says what was wrong, where, and what to do."""


def needed(name, package):
    """A Python package is missing: says what installs it.  Debian's own Python takes it from apt."""
    is_debians = sys.executable.startswith("/usr/bin/") and shutil.which("apt")
    command = f"sudo apt install {package}" if is_debians else f"{sys.executable} -m pip install {name}"
    return Problem(f"{name} is needed: {command}")


# pcapng ---------------------------------------------------------------------------------------------------------------

def padded(data):
    return data + bytes(-len(data) % 4)


def option(code, data):
    return struct.pack("=HH", code, len(data)) + padded(data)


def block(kind, body):
    size = struct.pack("=I", len(body) + 12)
    return struct.pack("=I", kind) + size + body + size


def head_of_file(link, names):
    """A section header, and an interface for each name; times are in nanoseconds."""
    blocks = [block(0x0A0D0D0A, struct.pack("=IHHq", 0x1A2B3C4D, 1, 0, -1))]
    for name in names:
        options = option(2, name.encode("utf-8", "replace")) + option(9, b"\x09") + option(0, b"")
        blocks.append(block(1, struct.pack("=HHI", link, 0, 0) + options))
    return b"".join(blocks)


def packet(interface, nanoseconds, data, lost):
    """A packet; the second interface is the other direction.  lost: number of packets dropped in front of it."""
    high, low = divmod(nanoseconds, 1 << 32)
    options = option(2, struct.pack("=I", 2 if interface else 1))  # epb_flags: direction
    options += option(4, struct.pack("=Q", lost)) if lost else b""  # epb_dropcount
    return block(6, struct.pack("=5I", interface, high, low, *[len(data)] * 2) + padded(data) + options + option(0, b""))


# Serial ports ---------------------------------------------------------------------------------------------------------

def serial_ports():
    """The ports there are, by name; none is opened."""
    if termios is None:
        import winreg  # pylint: disable=import-outside-toplevel,import-error
        key = r"HARDWARE\DEVICEMAP\SERIALCOMM"
        with contextlib.suppress(OSError), winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, key) as key:
            return sorted(winreg.EnumValue(key, i)[1] for i in range(winreg.QueryInfoKey(key)[1]))
        return []
    patterns = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyS*", "ttyTHS*", "ttymxc*", "rfcomm*", "cu.*")
    found = [path for pattern in patterns for path in glob.glob("/dev/" + pattern)]
    return sorted(path for path in found if not is_empty_slot(path))


def is_empty_slot(path):
    """Whether a ttyS of Linux has no hardware behind it."""
    with contextlib.suppress(OSError), open(f"/sys/class/tty/{os.path.basename(path)}/type", encoding="ascii") as file:
        return "/ttyS" in path and file.read().strip() == "0"
    return False


def is_locked(port):
    """Whether a program that runs took the port by a file with its number in /var/lock, as minicom and pppd do."""
    lock = "/var/lock/LCK.." + os.path.basename(port)
    with contextlib.suppress(OSError, ValueError), open(lock, encoding="ascii") as file:
        return os.path.exists(f"/proc/{int(file.read())}")
    return False


def not_permitted(port):
    import grp  # pylint: disable=import-outside-toplevel
    status, advice = os.stat(port), f"Until it is plugged in again, this permits it: sudo chown $USER {port}"
    for group in grp.getgrall():
        if group.gr_gid == status.st_gid != 0 and status.st_mode & 0o040:  # never into the group of root
            advice = f"It belongs to the group {group.gr_name}: sudo usermod -aG {group.gr_name} $USER, then log out and in again"
    return Problem(f"{port} may not be read by this user. {advice}")


def open_port(port):
    """A file descriptor of the port, ours alone."""
    busy = Problem(f"{port} is in use by another program: close that one, then start again")
    if is_locked(port):
        raise busy
    try:
        fd = os.open(port, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    except FileNotFoundError as problem:
        raise Problem(f"there is no port {port}. Plug it in; now there are: {', '.join(serial_ports()) or 'none'}") from problem
    except PermissionError as problem:
        raise not_permitted(port) from problem
    except OSError as problem:
        raise (busy if problem.errno == 16 else Problem(f"{port} cannot be opened: {problem.strerror}")) from problem
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # pyserial's way
        fcntl.ioctl(fd, termios.TIOCEXCL)  # the kernel's
    except BlockingIOError as problem:
        raise busy from problem
    except OSError as problem:
        raise Problem(f"{port} is not a serial port") from problem
    return fd


def set_line(fd, port, options):
    """8 data bits, as they come: no flow control, no translation."""
    rate = getattr(termios, f"B{options.baud}", None)
    control = termios.CS8 | termios.CREAD | termios.CLOCAL
    control |= {"none": 0, "even": termios.PARENB, "odd": termios.PARENB | termios.PARODD}[options.parity]
    control |= termios.CSTOPB if options.stopbits == "2" else 0
    try:
        attributes = termios.tcgetattr(fd)
        attributes[:6] = [0, 0, control, 0, *[rate or termios.B38400] * 2]
        attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
        termios.tcflush(fd, termios.TCIFLUSH)
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        if not rate:
            set_unusual_rate(fd, options.baud)
    except (OSError, termios.error) as problem:
        line = f"{options.baud} baud, parity {options.parity}, {options.stopbits} stop bits"
        raise Problem(f"{port} cannot be set to {line}: {problem.args[-1]}. Choose what the adapter can do") from problem


def set_unusual_rate(fd, baud):
    """A rate without a constant of its own."""
    if sys.platform == "darwin":
        fcntl.ioctl(fd, 0x80085402, struct.pack("=Q", baud))  # IOSSIOSPEED
    else:
        settings = bytearray(44)  # struct termios2: four flags, 20 bytes, two rates
        fcntl.ioctl(fd, 0x802C542A, settings)  # TCGETS2
        flags = struct.unpack_from("=I", settings, 8)[0] & ~0o010017 | 0o010000  # CBAUD, BOTHER
        struct.pack_into("=I", settings, 8, flags)
        struct.pack_into("=2I", settings, 36, baud, baud)
        fcntl.ioctl(fd, 0x402C542B, settings)  # TCSETS2


def open_by_termios(port, options):
    """Opens a port; returns how to read so many bytes, waiting so many seconds for the first, and how to close it."""
    fd = open_port(port)
    set_line(fd, port, options)

    def read(count, seconds):
        data = select.select([fd], [], [], seconds)[0] and os.read(fd, count)
        if data == b"":
            raise OSError("hung up")
        return data or b""

    def close():
        with contextlib.suppress(OSError):  # gone
            fcntl.ioctl(fd, termios.TIOCNXCL)  # somebody else may have it open
        os.close(fd)
    return read, close


def open_by_pyserial(port, options):
    """The same on Windows."""
    try:
        import serial  # pylint: disable=import-outside-toplevel
    except ImportError as problem:
        raise needed("pyserial", "python3-serial") from problem
    try:
        line = serial.Serial(port, options.baud, parity=options.parity[0].upper(), stopbits=int(options.stopbits))
    except (OSError, ValueError) as problem:
        raise Problem(f"{port} cannot be opened: {problem}. Plug it in, or close the program that has it open") from problem

    def read(count, seconds):
        line.timeout = seconds
        return line.read(1) + line.read(min(line.in_waiting, count - 1))
    return read, line.close


def serial_packets(port, options):
    """Yields nothing once, when the port is open; then (time in ns, packet) of what comes up to a pause."""
    if not port:
        name = (serial_ports() or ["/dev/ttyUSB0"])[0]
        raise Problem(f"no port was chosen: click the wheel beside the interface, or use -o extcap.yapp_serial.port:{name}")
    if options.port == options.second:
        raise Problem(f"{port} is both ports: choose the one with the other direction as the second, or none")
    read, close = (open_by_termios if termios else open_by_pyserial)(port, options)
    yield None
    gone = None
    while not gone and not options.stop.is_set():
        data = b""
        try:
            data = more = read(LARGEST, WAIT)
            now, end = time.time_ns(), time.monotonic() + LONGEST
            while more and len(data) < LARGEST and time.monotonic() < end:
                more = read(LARGEST - len(data), PAUSE)
                data += more
        except OSError as problem:
            gone = problem
        if data:
            yield now, EXPORTED_PDU + data
    close()
    if gone:
        raise Problem(f"{port} is gone: was it unplugged? What was captured is kept. Plug it in and start again") from gone


def serial_sources(options):
    port, second = ("" if port == "none" else port for port in (options.port, options.second))
    return [(name, serial_packets(name, options)) for name in [port, *filter(None, [second])]]


# CAN ------------------------------------------------------------------------------------------------------------------

def can_packet(message):
    """A packet of link type 227, SocketCAN: id and flags, length, flags of CAN FD, data."""
    number = message.arbitration_id
    number |= (message.is_extended_id and 1 << 31) | (message.is_remote_frame and 1 << 30) | (message.is_error_frame and 1 << 29)
    fd = message.is_fd and 4 | (message.bitrate_switch and 1) | (message.error_state_indicator and 2)
    data = b"" if message.is_remote_frame else bytes(message.data)
    return struct.pack(">IBBH", number, message.dlc, fd, 0) + data


def can_frames(options):
    """Yields nothing once, when the adapter is open; then (time in ns, packet) of what comes."""
    if not options.adapter:
        raise Problem("no adapter was chosen: click the wheel beside the interface, or use -o extcap.yapp_can.adapter:pcan")
    try:
        import can  # pylint: disable=import-outside-toplevel
    except ImportError as problem:
        raise needed("python-can", "python3-can") from problem
    data = {"fd": True, "data_bitrate": options.data_bitrate} if options.fd.lower() == "true" else {}
    try:
        bus = can.Bus(interface=options.adapter, channel=options.channel or None, bitrate=options.bitrate, **data)
    except Exception as problem:  # each adapter's library has its own
        raise Problem(f"{options.adapter} {options.channel} cannot be opened: {problem}") from problem
    yield None
    while not options.stop.is_set():
        try:
            message = bus.recv(WAIT)
        except Exception as problem:
            raise Problem(f"{options.adapter} {options.channel} is gone: {problem}. What was captured is kept") from problem
        if message is not None:
            # Some adapters count from their own start.
            now = round(message.timestamp * 1e9) if message.timestamp > 1e9 else time.time_ns()
            yield now, can_packet(message)
    bus.shutdown()


def can_sources(options):
    return [(f"{options.adapter} {options.channel}".strip(), can_frames(options))]


# Capture --------------------------------------------------------------------------------------------------------------

def read_settings(interface, options):
    """Turns the texts of the settings into values; raises what is wrong with one."""
    for argument in interface.arguments():
        name, title = argument["call"].lstrip("-").replace("-", "_"), argument["display"].lower()
        text, values = getattr(options, name), argument.get("values")
        if "range" in argument:
            low, high = map(int, argument["range"].split(","))
            if not text.isdecimal() or len(text) > 11 or not low <= int(text) <= high:
                raise Problem(f"{title}: a number from {low} to {high}, not {text[:20]!r}")
            setattr(options, name, int(text))
        elif name in ("parity", "stopbits") and text not in values:
            raise Problem(f"{title}: {', '.join(values[:-1])} or {values[-1]}, not {text[:20]!r}")


class Capture:
    """A capture into a fifo.  Threads read the sources and write the fifo, as both may block for ever."""

    def __init__(self, interface, options):
        options.stop = threading.Event()
        self.interface, self.options, self.sources = interface, options, interface.sources(options)
        self.waiting, self.written, self.fifo, self.problem = queue.Queue(), 0, None, None
        self.queued = [0] * len(self.sources)  # bytes of each source that were queued, as written counts those written
        self.lost = [0] * len(self.sources)  # packets of each source for which there was no room
        self.readers = [threading.Thread(target=self.read, args=(number, source), daemon=True)
                        for number, (_, source) in enumerate(self.sources)]
        self.writer = threading.Thread(target=self.write, daemon=True)

    def read(self, number, source):
        """Queues a source's packets, and at its end None or what ended it."""
        said, end = 0, None
        try:
            for now, data in source:
                if sum(self.queued) - self.written > MAX_WAITING:
                    self.lost[number] += 1
                    continue
                event = packet(number, now, data, self.lost[number] - said)
                said = self.lost[number]
                self.queued[number] += len(event)
                self.waiting.put(event)
        except Problem as problem:
            end = problem
        self.waiting.put(end)

    def write(self):
        try:
            with open(self.options.fifo, "wb") as self.fifo:  # first: what ends before that leaves dumpcap waiting
                self.put(head_of_file(self.interface.link, [name or self.interface.title for name, _ in self.sources]))
                read_settings(self.interface, self.options)
                for _, source in self.sources:
                    next(source)
                for reader in self.readers:
                    reader.start()
                for _ in self.sources:  # each ends with None
                    for event in iter(self.waiting.get, None):
                        self.put(event)
        except BrokenPipeError:
            pass  # Wireshark is gone: that is how captures end, too
        except OSError as problem:
            self.problem = Problem(f"{self.options.fifo} cannot be written: {problem.strerror}. "
                                   "Start the capture from Wireshark or tshark")
        except Problem as problem:
            self.problem = problem

    def put(self, event):
        if isinstance(event, Problem):
            raise event
        self.fifo.write(event)
        self.fifo.flush()
        self.written += len(event)

    def is_left(self):
        """Whether nobody reads the fifo any more."""
        if not self.fifo or self.fifo.closed or not hasattr(select, "poll"):
            return False
        poll = select.poll()
        poll.register(self.fifo, 0)
        return bool(poll.poll(0))

    def run(self):
        """Captures until a signal or a problem ends it, or Wireshark is gone; if that was killed, dumpcap would read on."""
        stop, before, parent = self.options.stop, None, os.getppid()
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: stop.set())
        self.writer.start()
        while self.writer.is_alive() and self.written != before and os.getppid() == parent and not self.is_left():
            before = self.written if stop.is_set() else None
            self.writer.join(STUCK if before is not None else WAIT)
        stop.set()
        for thread in filter(threading.Thread.is_alive, [*self.readers, self.writer]):
            thread.join(2 * WAIT)  # so that a port is closed, and a problem is known
        count = sum(self.lost) + (self.waiting.qsize() if self.written == before else 0)
        if count:
            print(f"YAPP: Wireshark did not read in time: {count} packets are not in the capture. Close other programs, "
                  "or use a faster disk", file=sys.stderr, flush=True)
        if self.problem:
            raise self.problem


# What Wireshark asks --------------------------------------------------------------------------------------------------

# arguments: the settings, as Wireshark's dialog has them; sources: gives (name, packets) of each port.
Interface = collections.namedtuple("Interface", "title link link_name arguments sources")


def serial_arguments():
    # COMPAT 4.0: it knows no editselector; and nothing tells the version when settings are asked for.
    ports = serial_ports()
    return [
        {"call": "--port", "display": "Port", "type": "selector", "required": "true", "reload": "true",
         "placeholder": "Look again", "tooltip": "The port with the controller's data", "values": ports or ["none"]},
        {"call": "--baud", "display": "Baud rate", "type": "unsigned", "default": "500000", "range": "50,20000000"},
        {"call": "--parity", "display": "Parity", "type": "selector", "values": ["none", "even", "odd"], "default": "none"},
        {"call": "--stopbits", "display": "Stop bits", "type": "selector", "values": ["1", "2"], "default": "1"},
        {"call": "--second", "display": "Second port", "type": "selector", "values": ["none", *ports], "default": "none",
         "tooltip": "A port with the data of the other direction"},
    ]


def can_arguments():
    adapters = ["pcan", "vector", "kvaser", "ixxat", "slcan", "gs_usb", "canalystii", "usb2can", "seeedstudio", "nixnet",
                "socketcan", "virtual"]
    return [
        {"call": "--adapter", "display": "Adapter", "type": "selector", "required": "true", "values": adapters},
        {"call": "--channel", "display": "Channel", "type": "string", "tooltip": "python-can's: PCAN_USBBUS1, 0, can0"},
        {"call": "--bitrate", "display": "Bit rate", "type": "unsigned", "default": "1000000", "range": "1,100000000"},
        {"call": "--fd", "display": "CAN FD", "type": "boolflag", "default": "false"},
        {"call": "--data-bitrate", "display": "Bit rate of CAN FD data", "type": "unsigned", "default": "5000000",
         "range": "1,100000000"},
    ]


INTERFACES = {
    "yapp-serial": Interface("YAPP serial port", 252, "WIRESHARK_UPPER_PDU", serial_arguments, serial_sources),
    "yapp-can": Interface("YAPP CAN adapter", 227, "CAN_SOCKETCAN", can_arguments, can_sources),
}


def list_interfaces():
    print(f"extcap {{version={VERSION}}}{{display=YAPP live ports}}")
    for value, interface in INTERFACES.items():
        if value == "yapp-serial" or importlib.util.find_spec("can"):
            print(f"interface {{value={value}}}{{display={interface.title}}}")


def list_settings(interface, only=None):
    """The arguments of the dialog; or, asked again, only the values of one."""
    for number, argument in enumerate(interface.arguments()):
        values = argument.pop("values", [])
        if not only or only.lstrip("-") == argument["call"].lstrip("-"):
            if not only:
                print(f"arg {{number={number}}}" + "".join(f"{{{key}={value}}}" for key, value in argument.items()))
            for value in values:
                default = "true" if value == argument.get("default") else "false"
                print(f"value {{arg={number}}}{{value={value}}}{{display={value}}}{{default={default}}}")


def parse(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     allow_abbrev=False)
    for flag in ("--extcap-interfaces", "--extcap-dlts", "--extcap-config", "--capture"):
        parser.add_argument(flag, action="store_true")
    for name in ("--extcap-interface", "--extcap-reload-option", "--fifo"):
        parser.add_argument(name)
    for interface in INTERFACES.values():
        for argument in interface.arguments():
            parser.add_argument(argument["call"], nargs="?", const="true", default=argument.get("default", ""))
    return parser.parse_known_args(arguments)[0]


def answer(options):
    if options.extcap_interfaces:
        return list_interfaces()
    interface = INTERFACES.get(options.extcap_interface)
    if not interface:
        raise Problem(f"there is no interface {options.extcap_interface!r}, but {' and '.join(INTERFACES)}")
    if options.extcap_dlts:
        return print(f"dlt {{number={interface.link}}}{{name={interface.link_name}}}{{display={interface.title}}}")
    if options.extcap_config or options.extcap_reload_option:
        return list_settings(interface, options.extcap_reload_option)
    if options.capture and options.fifo:
        return Capture(interface, options).run()
    raise Problem("run by Wireshark; --help tells more")


def main(arguments=None):
    try:
        answer(parse(arguments))
    except Problem as problem:
        print(f"YAPP: {problem}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads may be waiting in a driver
