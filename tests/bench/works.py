# SPDX-License-Identifier: GPL-2.0-or-later
"""What `make bench` measures: each work with its peers, as command lines.

    none    tshark without the plugin          floor   tests/bench/floor.lua, the least that a Lua dissector does
    isotp   tshark's own reassembly, in C      script  tests/bench/peer.py, what one would write instead
    now     the plugin                         before  another version of it
    one     the plugin's, of one interface
    list    the plugin's packet list           hand    tests/bench/by_hand.lua, one message and nothing besides
"""
import pathlib
import typing

from traffic import FRAMES

HERE = pathlib.Path(__file__).resolve().parent
LIST, FILTER, VERBOSE, VALUES, TABLES = ("packet list", "one fault filter", "`-V`", "`-T fields`, the 13 Motor Data values",
                                         "all values in one pass, `-z yapp,csv`")
UART, START, LOG = "UART, packets of 64 bytes", "start: a capture of one frame", "candump log"
BUSES, PASSES = "packet list of two interfaces", "packet list in two passes, `-2`"
LONG_LIST, LONG_LOG = "packet list, ten times the frames", "candump log, long"
CONVERT, LONG_CONVERT = "candump log to {}, `yapp-tables`", "pcap to Parquet, `yapp-tables`, ten times the frames"
MOTOR = ("torque_iq_commanded torque_iq_measured rpm_commanded rpm_measured dc_voltage dc_current motor_temperature motor_mode "
         "status_flags fault_flags timestamp motor_state esc_temperature").split()
LONG = (LONG_LIST, LONG_LOG, LONG_CONVERT)
VALUE_FIELDS = ["-T", "fields", *(word for name in MOTOR for word in ("-e", f"taurus.motor.{name}"))]
FAULT = "taurus.motor.fault.motor_overcurrent"
LONGER, LOG_LONGER = 10, 30  # times the usual traffic


class Target(typing.NamedTuple):
    """How much the plugin may take: of what the peer takes, or (difference) seconds more than it."""
    peer: str
    limit: float
    difference: bool = False


class Work(typing.NamedTuple):
    title: str
    commands: dict  # { peer: command line }
    target: Target = None
    times: int = 1  # how often it is measured where others are once


def convert(shark, python, capture, kind):
    """yapp-tables from nothing: a result that is up to date would not be made again."""
    out = shark.folder / kind
    command = [python, "-m", "yapp_tables", "convert", shark.folder / capture, "--to", kind, "--out", out,
               "--plugin", shark.plugin / "yapp.lua"]
    return ["sh", "-c", f"rm -rf {out} {out}.yapp-tables && {' '.join(map(str, command))} && echo done"]


class Shark:
    """tshark's command lines."""

    def __init__(self, plugin, folder):
        self.plugin, self.folder = plugin, folder

    def none(self, capture, *arguments):
        return ["tshark", "-r", str(self.folder / capture), *arguments]

    def now(self, capture, *arguments):
        return ["tshark", "-X", load(self.plugin), *self.none(capture, *arguments)[1:]]

    def isotp(self, *arguments):
        return [*self.none("isotp.pcap", *arguments), "-d", "can.subdissector,iso15765"]

    def script(self, name, level, *arguments):
        return ["tshark", "-X", f"lua_script:{HERE / name}", "-X", f"lua_script1:{level}",
                *self.none("yapp.pcap", *arguments)[1:]]

    def floor(self, level, *arguments):
        return self.script("floor.lua", level, *arguments)

    def hand(self, *arguments):
        """Its fields have the plugin's names, but for what they begin with."""
        return self.script("by_hand.lua", "run", *(word.replace("taurus.motor.", "by_hand.") for word in arguments))


def load(plugin):
    return f"lua_script:{plugin / 'yapp.lua'}"


def works(shark, python, messages):
    """The works on a folder with all of the traffic.

    shark   Shark;  python: the command of a Python that has python-can;  messages: how many the traffic has"""
    floor, hand, now, none, isotp = shark.floor, shark.hand, shark.now, shark.none, shark.isotp
    of_script = [python, str(HERE / "peer.py"), str(shark.folder / "yapp.log"), str(shark.folder / "script.csv")]
    tables = ["-q", "-z", f"yapp,csv,{shark.folder / 'tables'},replace"]
    count = f"{messages * FRAMES:,}"
    return [
        Work(LIST, {"none": none("yapp.pcap"), "isotp": isotp(), "empty": floor("empty"), "floor": floor("columns"),
                    "asked": floor("asked"), "hand": hand(), "now": now("yapp.pcap")}, Target("hand", 1.25)),
        Work(FILTER, {"none": none("yapp.pcap", "-Y", "frame.number % 5 == 0"),
                      "isotp": isotp("-Y", "iso15765.reassembled.length"),
                      "floor": floor("gated", "-Y", "floor.f1"), "hand": hand("-Y", FAULT),
                      "now": now("yapp.pcap", "-Y", FAULT)},
             Target("hand", 1.4)),
        Work(VERBOSE, {"none": none("yapp.pcap", "-V"), "isotp": isotp("-V"), "floor": floor("tree", "-V"),
                       "hand": hand("-V"), "now": now("yapp.pcap", "-V")}, Target("hand", 1.25)),
        Work(VALUES, {"hand": hand(*VALUE_FIELDS), "now": now("yapp.pcap", *VALUE_FIELDS)},
             Target("hand", 1.25)),
        Work(TABLES, {"script": of_script, "list": now("yapp.log"), "now": now("yapp.log", *tables)}, Target("script", 1.15)),
        *(Work(CONVERT.format(title), {"script": of_script, "now": convert(shark, python, "yapp.log", kind)}, Target("script", 1.3))
          for title, kind in (("CSV", "csv"), ("Parquet", "parquet"), ("Delta", "delta"))),
        Work(f"{count} UDP packets", {"none": none("udp.pcap"), "now": now("udp.pcap")}, Target("none", 1.02)),
        Work(f"{count} foreign CAN frames", {"none": none("isotp.pcap"), "now": now("isotp.pcap")}, Target("none", 1.05)),
        Work(UART, {"none": none("uart.pcap"), "list": now("yapp.pcap"), "now": now("uart.pcap")}, Target("list", 0.8)),
        Work(LOG, {"none": none("yapp.log"), "now": now("yapp.log")}, Target("none", 2.5)),
        Work(BUSES, {"one": now("one_bus.pcapng"), "now": now("two_buses.pcapng")}, Target("one", 1.1)),
        Work(PASSES, {"none": none("yapp.pcap", "-2"), "now": now("yapp.pcap", "-2")}, Target("none", 5.0)),
        Work(START, {"none": none("one.pcap"), "now": now("one.pcap")}, Target("none", 0.04, difference=True), times=4),
    ]


def long_works(short, long, python):
    """The works on long captures: Sharks of the usual traffic, and of a folder with LONGER times as much of yapp.pcap and
    isotp.pcap, LOG_LONGER times as much of yapp.log."""
    both = {}
    for ending, shark in (("", long), (" short", short)):
        both.update({f"none{ending}": shark.none("yapp.pcap"), f"isotp{ending}": shark.isotp(),
                     f"now{ending}": shark.now("yapp.pcap")})
    return [Work(LONG_LIST, both), Work(LONG_LOG, {"none": long.none("yapp.log"), "now": long.now("yapp.log")},
                                       Target("none", 2.5)),
            Work(LONG_CONVERT, {f"now{ending}": convert(shark, python, "yapp.pcap", "parquet")
                                for ending, shark in (("", long), (" short", short))})]


def with_version(work, plugin, other):
    """The work with another version of the plugin as a peer: where the command line has the plugin's, it has this one's."""
    def command(line):
        return [word.replace(str(plugin / "yapp.lua"), str(other / "yapp.lua")) for word in line]

    added = {peer.replace("now", "before"): command(line) for peer, line in work.commands.items() if peer.startswith("now")}
    return work._replace(commands={**work.commands, **added})
