#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Live ports for Wireshark (an extcap): a serial port that carries YAPP, and CAN adapters that python-can knows.

Wireshark runs this file by itself, once it lies in the extcap folder; docs/live.md says how to use it.  By hand:

    tshark -i yapp-serial -o extcap.yapp_serial.port:/dev/ttyUSB0
    tshark -i yapp-can -o extcap.yapp_can.adapter:pcan -o extcap.yapp_can.channel:PCAN_USBBUS1

Python 3.7 or later.  Serial ports need nothing else on Linux and macOS, and pyserial on Windows; CAN needs python-can.
"""
import argparse
import glob
import importlib.util
import os
import queue
import select
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

VERSION = "2.2.0"
LINK_EXPORTED_PDU, LINK_CAN = 252, 227
PAUSE = 0.002  # seconds: bytes with no longer pause between them are one packet,
LONGEST = 0.02  # of no more seconds than this,
LARGEST = 4096  # and no more bytes
WAIT = 0.2  # seconds, after which a source looks whether it is to stop


class Problem(Exception):
    """What ends a capture, as a sentence that says what to do."""


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


def packet(interface, nanoseconds, data, outbound):
    high, low = divmod(nanoseconds, 1 << 32)
    flags = option(2, struct.pack("=I", 2 if outbound else 1)) + option(0, b"")
    return block(6, struct.pack("=5I", interface, high, low, len(data), len(data)) + padded(data) + flags)


# Serial ports ---------------------------------------------------------------------------------------------------------

def serial_ports():
    """The ports there are, by name; none is opened."""
    if termios is None:
        import winreg  # pylint: disable=import-outside-toplevel,import-error
        try:
            with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"HARDWARE\DEVICEMAP\SERIALCOMM") as key:
                return sorted(winreg.EnumValue(key, i)[1] for i in range(winreg.QueryInfoKey(key)[1]))
        except OSError:
            return []
    found = [path for pattern in ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyS*", "ttyTHS*", "ttymxc*", "rfcomm*", "cu.*")
             for path in glob.glob("/dev/" + pattern)]
    return sorted(path for path in found if not is_empty_slot(path))


def is_empty_slot(path):
    """Whether a ttyS of Linux has no hardware behind it."""
    try:
        with open(f"/sys/class/tty/{os.path.basename(path)}/type", encoding="ascii") as file:
            return "/ttyS" in path and file.read().strip() == "0"
    except OSError:
        return False


def owner_of_lock(port):
    """The number of the process that took the port in the old way, a file in /var/lock, as minicom and pppd do."""
    try:
        with open("/var/lock/LCK.." + os.path.basename(port), encoding="ascii") as file:
            number = int(file.read())
        os.kill(number, 0)
    except PermissionError:
        return number
    except (OSError, ValueError):
        return None
    return number


def not_permitted(port):
    import grp  # pylint: disable=import-outside-toplevel
    group = grp.getgrgid(os.stat(port).st_gid).gr_name
    return Problem(f"{port} may not be read by this user. It belongs to the group {group}: "
                   f"sudo usermod -aG {group} $USER, then log out and in again")


def open_port(port):
    """A file descriptor of the port, ours alone."""
    busy = Problem(f"{port} is in use by another program: close that one, then start again")
    if owner_of_lock(port):
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


def set_line(fd, options):
    """8 data bits, as they come: no flow control, no translation."""
    rate = getattr(termios, f"B{options.baud}", None)
    control = termios.CS8 | termios.CREAD | termios.CLOCAL
    control |= {"none": 0, "even": termios.PARENB, "odd": termios.PARENB | termios.PARODD}[options.parity]
    control |= termios.CSTOPB if options.stopbits == "2" else 0
    attributes = termios.tcgetattr(fd)
    attributes[:4] = [0, 0, control, 0]
    attributes[4:6] = [rate or termios.B38400] * 2
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
    try:
        termios.tcsetattr(fd, termios.TCSANOW, attributes)
        if not rate:
            set_unusual_rate(fd, options.baud)
        termios.tcflush(fd, termios.TCIFLUSH)
    except (OSError, termios.error) as problem:
        raise Problem(f"{options.port} cannot be set to {options.baud} baud, parity {options.parity}, {options.stopbits} stop "
                      f"bits: {problem.args[-1]}") from problem


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


def pieces(port, options):
    """Yields nothing once, when the port is open; then (time in ns, bytes) of what comes, until the port is gone."""
    fd = open_port(port)
    try:
        set_line(fd, options)
        yield None
        while not options.stop.is_set():
            if select.select([fd], [], [], WAIT)[0]:
                yield from piece(fd, port)
    finally:
        try:
            fcntl.ioctl(fd, termios.TIOCNXCL)  # somebody else may have it open
        except OSError:
            pass  # gone
        os.close(fd)


def piece(fd, port):
    """What comes now, up to a pause."""
    data, now, end = b"", time.time_ns(), time.monotonic() + LONGEST
    try:
        while len(data) < LARGEST and time.monotonic() < end and select.select([fd], [], [], PAUSE)[0]:
            more = os.read(fd, LARGEST - len(data))
            if not more:
                raise OSError("hung up")
            data += more
    except OSError as problem:
        if data:
            yield now, data
        raise gone(port) from problem
    if data:
        yield now, data


def gone(port):
    return Problem(f"{port} is gone: was it unplugged? What was captured is kept. Plug it in and start again")


def pieces_by_pyserial(port, options):
    """The same on Windows."""
    try:
        import serial  # pylint: disable=import-outside-toplevel
    except ImportError as problem:
        raise Problem(f"pyserial is needed: {sys.executable} -m pip install pyserial") from problem
    try:
        line = serial.Serial(port, options.baud, parity=options.parity[0].upper(), stopbits=int(options.stopbits), timeout=WAIT)
    except (OSError, ValueError) as problem:
        raise Problem(f"{port} cannot be opened: {problem}. Is it plugged in, or open in another program? Ports: "
                      f"{', '.join(serial_ports()) or 'none'}") from problem
    yield None
    while not options.stop.is_set():
        try:
            data, now, end = line.read(1), time.time_ns(), time.monotonic() + LONGEST
            while data and time.monotonic() < end:
                time.sleep(PAUSE)
                if not line.in_waiting:
                    break
                data += line.read(line.in_waiting)
        except OSError as problem:
            raise gone(port) from problem
        if data:
            yield now, data


def exported_pdu(data, dissector=b"yapp_serial"):
    """A packet of link type 252: the dissector's name, then its bytes."""
    return struct.pack(">HH", 12, len(padded(dissector))) + padded(dissector) + bytes(4) + data


def serial_packets(port, options):
    """Yields nothing once, when the port is open; then (time in ns, packet) of what comes."""
    if not port:
        raise Problem("no port was chosen. In Wireshark: the wheel beside the interface; tshark: -o extcap.yapp_serial.port:"
                      f"{(serial_ports() or ['/dev/ttyUSB0'])[0]}")
    if options.port == options.second:
        raise Problem(f"{port} is both ports: choose the one with the other direction as the second, or none")
    for got in (pieces if termios else pieces_by_pyserial)(port, options):
        yield got and (got[0], exported_pdu(got[1]))


def serial_sources(options):
    """The name of each source, and what it gives; the second is the other direction."""
    return [(port, serial_packets(port, options)) for port in [options.port, *filter(None, [options.second])]]


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
        raise Problem("no adapter was chosen. In Wireshark: the wheel beside the interface; tshark: -o "
                      "extcap.yapp_can.adapter:pcan -o extcap.yapp_can.channel:PCAN_USBBUS1")
    try:
        import can  # pylint: disable=import-outside-toplevel
    except ImportError as problem:
        raise Problem(f"python-can is needed: {sys.executable} -m pip install python-can") from problem
    settings = {"bitrate": options.bitrate}
    if options.fd:
        settings.update(fd=True, data_bitrate=options.data_bitrate)
    try:
        bus = can.Bus(interface=options.adapter, channel=options.channel or None, **settings)
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

def forward(number, source, put):
    """In a thread of its own: a source's packets, and what ends it.  The second source is the other direction."""
    try:
        for now, data in source:
            put(packet(number, now, data, number > 0))
    except Problem as problem:
        put(problem)


def is_left(fifo, parent):
    """Whether nobody reads any more, or Wireshark has died: dumpcap would read on."""
    if not hasattr(select, "poll"):
        return False
    poll = select.poll()
    poll.register(fifo, 0)
    return os.getppid() != parent or bool(poll.poll(0))


def capture(interface, options):
    """Writes what comes into the fifo, until told to stop or nobody reads."""
    events, parent = queue.SimpleQueue(), os.getppid()
    for name in ("SIGTERM", "SIGINT"):
        signal.signal(getattr(signal, name), lambda *_: events.put(None))
    options.stop = threading.Event()
    sources = interface.sources(options)
    threads = [threading.Thread(target=forward, args=(number, source, events.put), daemon=True)
               for number, (_, source) in enumerate(sources)]
    with open(options.fifo, "wb", buffering=0) as fifo:  # first: what ends before that leaves dumpcap waiting
        fifo.write(head_of_file(interface.link, [name or interface.title for name, _ in sources]))
        for value in vars(options).values():
            if isinstance(value, Problem):
                raise value
        for _, source in sources:
            next(source)
        for thread in threads:
            thread.start()
        try:
            write_packets(fifo, events, lambda: is_left(fifo, parent))
        finally:
            options.stop.set()
            for thread in threads:
                thread.join(2 * WAIT)


def write_packets(fifo, events, is_over):
    while True:
        try:
            event = events.get(timeout=0.5)
        except queue.Empty:
            if is_over():
                return
            continue
        if event is None:
            return
        if isinstance(event, Problem):
            raise event
        fifo.write(event)


# What Wireshark asks --------------------------------------------------------------------------------------------------

class Interface:
    """One of Wireshark's interfaces: its link type, its settings as arguments of Wireshark's dialog, and its sources."""

    def __init__(self, title, link, link_name, arguments, sources):
        self.title, self.link, self.link_name, self.arguments, self.sources = title, link, link_name, arguments, sources


def serial_arguments():
    # COMPAT 4.0: it knows no editselector; and nothing tells the version when settings are asked for.
    ports = serial_ports()
    return [
        {"call": "--port", "display": "Port", "type": "selector", "required": "true", "reload": "true",
         "placeholder": "Look again", "tooltip": "The port with the controller's data", "values": ports or ["none"]},
        {"call": "--baud", "display": "Baud rate", "type": "unsigned", "default": "500000", "range": "50,20000000",
         "tooltip": "Taurus: 500000"},
        {"call": "--parity", "display": "Parity", "type": "selector", "values": ["none", "even", "odd"], "default": "none"},
        {"call": "--stopbits", "display": "Stop bits", "type": "selector", "values": ["1", "2"], "default": "1"},
        {"call": "--second", "display": "Second port", "type": "selector", "values": ["none", *ports], "default": "none",
         "tooltip": "A port with the data of the other direction"},
    ]


def can_arguments():
    adapters = ["pcan", "vector", "kvaser", "ixxat", "slcan", "gs_usb", "canalystii", "usb2can", "seeedstudio", "nixnet",
                "socketcan", "virtual"]
    return [
        {"call": "--adapter", "display": "Adapter", "type": "selector", "required": "true", "values": adapters,
         "tooltip": "python-can's name of it ('interface')"},
        {"call": "--channel", "display": "Channel", "type": "string",
         "tooltip": "As python-can has it: PCAN_USBBUS1, 0, COM5, can0"},
        {"call": "--bitrate", "display": "Bit rate", "type": "unsigned", "default": "1000000"},
        {"call": "--fd", "display": "CAN FD", "type": "boolflag", "default": "false"},
        {"call": "--data-bitrate", "display": "Bit rate of CAN FD data", "type": "unsigned", "default": "5000000"},
    ]


INTERFACES = {
    "yapp-serial": Interface("YAPP serial port", LINK_EXPORTED_PDU, "WIRESHARK_UPPER_PDU", serial_arguments, serial_sources),
    "yapp-can": Interface("YAPP CAN adapter", LINK_CAN, "CAN_SOCKETCAN", can_arguments, can_sources),
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
        if only in (None, argument["call"].lstrip("-"), argument["call"]):
            if only is None:
                print(f"arg {{number={number}}}" + "".join(f"{{{key}={value}}}" for key, value in argument.items()))
            for value in values:
                default = "true" if value == argument.get("default") else "false"
                print(f"value {{arg={number}}}{{value={value}}}{{display={value}}}{{default={default}}}")


def number(name):
    """Reads a setting; what is wrong with it is told when the fifo is open: what ends before that leaves dumpcap waiting."""
    return lambda text: int(text) if text.isdecimal() else Problem(f"{name} is a number, not {text!r}")


def one_of(name, *values):
    return lambda text: text if text in values else Problem(f"{name} is {', '.join(values[:-1])} or {values[-1]}, not {text!r}")


def parse(arguments):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     allow_abbrev=False)
    for flag in ("interfaces", "dlts", "config"):
        parser.add_argument("--extcap-" + flag, action="store_true")
    parser.add_argument("--extcap-interface", default="")
    parser.add_argument("--extcap-reload-option")
    parser.add_argument("--capture", action="store_true")
    parser.add_argument("--fifo")
    for name in ("adapter", "channel"):
        parser.add_argument("--" + name, default="")
    for name in ("port", "second"):
        parser.add_argument("--" + name, default="", type=lambda text: "" if text == "none" else text)
    parser.add_argument("--baud", type=number("the baud rate"), default=500000)
    parser.add_argument("--parity", type=one_of("parity", "none", "even", "odd"), default="none")
    parser.add_argument("--stopbits", type=one_of("the number of stop bits", "1", "2"), default="1")
    parser.add_argument("--bitrate", type=number("the bit rate"), default=1000000)
    parser.add_argument("--fd", nargs="?", const=True, default=False, type=lambda text: text.lower() == "true")
    parser.add_argument("--data-bitrate", type=number("the bit rate of data"), default=5000000)
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
        return capture(interface, options)
    raise Problem("run by Wireshark; --help tells more")


def main(arguments=None):
    try:
        answer(parse(arguments))
    except BrokenPipeError:
        pass  # Wireshark is gone: that is how captures end, too
    except Problem as problem:
        print(f"YAPP: {problem}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # threads may be waiting in a driver
