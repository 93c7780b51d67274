# SPDX-License-Identifier: GPL-2.0-or-later
"""Where not all was read, or the plugin itself failed, no statistic says that all is well."""
import random
import shutil
import struct
import subprocess

import pytest

import capture_file
import levels
import model
import tshark

# One statistic in each form of its output; csv prints one table.
FORMS = [name if name != "csv" else "csv,-,motor" for name in model.STATISTICS]
FORMS += [name + ",json" for name in model.STATISTICS if name != "csv"]
CLEAN = tshark.CAPTURES / "cases/g0_clean.pcapng"
RING = tshark.CAPTURES / "cases/ring_fault_in_third_file.pcapng"


def taps(*whats):
    return [word for what in whats for word in ("-z", f"yapp,{what}")]


def assert_told(done, whats, text):
    """On stderr, and above the table of each statistic that has one."""
    assert text in done.stderr and done.stdout.count(text) >= sum(what in model.IN_TEXT for what in whats)


def test_a_preference_that_cannot_be_read():
    done = tshark.run("-q", "-r", CLEAN, "-o", "yapp.late:often", *taps(*FORMS), check=False)
    assert done.returncode == 21 and done.stderr.count("yapp.late") == 1
    assert_told(done, FORMS, 'yapp.late: no number above 0 in "often"')


def test_nothing_is_wrong_without_it():
    done = tshark.run("-q", "-r", CLEAN, *taps(*FORMS), check=False)
    assert done.returncode == 0 and all(f"YAPP {name}: " in done.stdout for name in model.IN_TEXT)


# The plugin fails --------------------------------------------------------------------------------------------------------

# Where an error is planted: behind the first line of a function.
PLACES = [("yapp/stat/events.lua", "function Events:add("),  # in taps of packets
          ("yapp/stat/run.lua", "function Run:packet(number, rel, has_clock)")]


def planted(folder, path, line, code):
    plugin = tshark.copy_plugin(folder)
    lines = (plugin / path).read_text().split("\n")
    at = next(index for index, text in enumerate(lines) if text.startswith(line))
    lines.insert(at + 1, code)
    (plugin / path).write_text("\n".join(lines))
    return plugin / "yapp.lua"


FAILING_DISSECTOR = """
  local dissect = frames.dissect
  function frames.dissect(self, tvb, pinfo, ...)
    if pinfo.number == 25 then error('planted') end
    return dissect(self, tvb, pinfo, ...)
  end"""
FAILING = "YAPP_CALLS = (YAPP_CALLS or 0) + 1; if YAPP_CALLS % 7 == 3 then error('planted') end"


WITHOUT_CHECK = [what for what in FORMS if not what.startswith("check")]  # a failed rule is the worse end


@pytest.mark.parametrize("path, line", PLACES)
def test_a_lua_error_in_a_tap(folder, path, line):
    script = planted(folder, path, line, FAILING)
    done = tshark.run("-X", f"lua_script:{script}", "-q", "-r", CLEAN, *taps(*WITHOUT_CHECK), check=False, plugin=False, lua_errors=True)
    assert done.returncode == 21
    assert_told(done, WITHOUT_CHECK, "the plugin failed")


@pytest.mark.parametrize("whats, code", [(["check"], 20), (WITHOUT_CHECK, 21)], ids=["check", "others"])
def test_a_lua_error_in_a_dissector(folder, whats, code):
    """In the frame that ends a message: with it the message is lost."""
    script = planted(folder, "yapp.lua", "local function reset_reading()", FAILING_DISSECTOR)
    done = tshark.run("-X", f"lua_script:{script}", "-q", "-r", CLEAN, *taps(*whats), check=False, plugin=False, lua_errors=True)
    assert done.returncode == code
    assert_told(done, whats, "the plugin failed")


# A ring of files ---------------------------------------------------------------------------------------------------------

def capture(folder, ring, *arguments, ending="pcapng", path=RING):
    """tshark captures what comes by its standard input."""
    with open(path, "rb") as stdin:
        command = ["tshark", *tshark.load(), "-i", "-", *ring, "-w", folder / f"run.{ending}", *arguments]
        done = subprocess.run([*map(str, command)], stdin=stdin, capture_output=True, text=True, timeout=60, check=False,
                              **tshark._user())
    return done, sorted(folder.glob("run*"))


def test_a_live_capture_that_goes_on_in_new_files(folder):
    whats = ["check", "faults", "events,json", "csv,-,motor"]
    done, files = capture(folder, ["-b", "packets:25"], "-q", *taps(*whats))
    assert len(files) > 2 and done.returncode == 21  # on a slow machine a file may have more than 25 packets
    assert_told(done, whats, " packets were read: of a live capture with -b tshark analyses the first file")


def test_a_failed_rule_stays_failed_where_more_packets_cannot_mend_it(folder):
    done, _ = capture(folder, ["-b", "packets:75"], "-q", "-z", "yapp,check,fault=0,motor.count=1000")
    assert done.returncode == 20 and "FAILED      fault=0" in done.stdout and "NOT JUDGED  motor.count=1000" in done.stdout


# Packets that tshark does not read, or forgets ---------------------------------------------------------------------------

RESET = tshark.CAPTURES / "cases/session_reset.pcapng"  # of 408 packets; a fault rises in the 140th
PACKETS = 408


@pytest.mark.parametrize("options, code, said", [
    (["-c", "100"], 21, "ended the reading"), (["-c408"], 20, ""), (["-M", "408"], 20, ""),
    (["-2", "-R", "can", "-c", "300"], 20, "ended the reading"), (["-2", "-R", "can", "-c", "500"], 20, ""),
    (["-a", "packets:136"], 21, "ended the reading"), (["-z", "yapp,watch,stop=fault"], 20, "ended the reading"),
    (["-M", "139"], 21, f"only 139 of {PACKETS} packets were read, as tshark -M forgets"), (["-M", "300"], 20, "as tshark -M forgets")])
def test_a_count_of_packets(options, code, said):
    done = tshark.run(*options, "-r", RESET, "-q", "-z", "yapp,check,fault=0", check=False)
    assert (done.returncode, "packets were read" in done.stderr) == (code, said != "") and said in done.stderr, done.stderr
    assert "YAPP check: " in done.stdout


def test_a_count_of_packets_behind_a_read_filter():
    """The plugin does not count the packets of pcap: how many -R left out is not known."""
    for more, code in ([], 0), (["-c", "90000"], 21):
        done = tshark.run("-2", "-R", "can", *more, "-r", tshark.CAPTURES / "can/command.pcap", "-q", "-z", "yapp,check,crc=0",
                          check=False)
        assert (done.returncode, "ended the reading" in done.stderr) == (code, code != 0), done.stderr


def test_a_file_that_begins_with_others(folder):
    """For a statistic all of it is read, as its end says what was lost; and its packets are counted."""
    path, loss = folder / "run.pcapng", capture_file.option(5, struct.pack("<Q", 7))
    packets = [capture_file.packet(at, bytes(1000)) for at in range(100)] + [capture_file.block(5, bytes(12) + loss)]
    path.write_bytes(capture_file.section(capture_file.interface(1)) + b"".join(packets))
    for more, is_said in ([], False), (["-c", "90"], True):
        done = tshark.run(*more, "-r", path, "-q", "-z", "yapp,check,dropped=6", check=False)
        assert (done.returncode, "ended the reading" in done.stderr) == (20, is_said), done.stderr


# Files that end early ----------------------------------------------------------------------------------------------------

CUT = "the file ends early"


def ends_early(path):
    """Whether a statistic says it, and its exit code.  Some versions end with a code of their own."""
    done = tshark.run("-r", path, "-q", "-z", "yapp,check,crc=0", check=False)
    assert "YAPP check: " in done.stdout
    return CUT in done.stderr, done.returncode


@pytest.mark.parametrize("name", ["cut.blf", "killed.log.zst"])
def test_a_recorder_that_lost_power(name):
    path = tshark.CAPTURES / "cases" / name
    rules = "motor.dc_voltage=40..55,motor.count=100,crc=0"
    done = tshark.run("-r", path, "-q", "-z", f"yapp,check,{rules}", "-z", "yapp,faults", check=False)
    assert done.returncode == 21 and CUT in done.stderr and CUT in done.stdout


@pytest.mark.parametrize("ending", ["blf", "blf.zst", "log.zst", "log.lz4", "pcapng.zst"])
def test_whole_files(ending):
    path = next((tshark.CAPTURES / "other").glob(f"*.{ending}"))
    assert not ends_early(path)[0]


def test_blf_that_was_cut_anywhere(folder):
    """Also one that its recorder never closed: its size is that of the head."""
    whole, path = (tshark.CAPTURES / "other/motor.blf").read_bytes(), folder / "cut.blf"
    for count in (len(whole) - 1, len(whole) - 40):
        path.write_bytes(whole[:count])
        assert ends_early(path)[0], count
    path.write_bytes(whole[:16] + (144).to_bytes(8, "little") + whole[24:])
    assert ends_early(path) == (True, 21)


@pytest.mark.parametrize("program, options", [
    ("zstd", []), ("zstd", ["--no-check"]), ("lz4", []), ("lz4", ["-BX", "--content-size", "-B4"]), ("lz4", ["--no-frame-crc"])])
def test_compressed_logs_that_were_cut_anywhere(folder, program, options):
    """Several frames in a file, too, as of a recorder that goes on."""
    if not shutil.which(program):
        pytest.skip(f"no {program} here")
    rng, log = random.Random(f"{program} {options}"), (tshark.CAPTURES / "cases/bus_off.log").read_bytes()
    part = subprocess.run([program, "-cq", *options], input=log * 4, capture_output=True, check=True).stdout
    whole, path = part + part, folder / ("cut.log.zst" if program == "zstd" else "cut.log.lz4")
    path.write_bytes(whole)
    assert ends_early(path) == (False, 0)
    for count in rng.sample(range(len(part) + 100, len(whole)), levels.size(1, 4)):
        path.write_bytes(whole[:count])
        told, code = ends_early(path)
        assert told and code, count


# Frames that Wireshark refuses -------------------------------------------------------------------------------------------

def test_can_fd_without_its_flag():
    """Wireshark 4.6 dissects none of its 72 long frames; earlier versions do."""
    path = tshark.CAPTURES / "cases/canfd_without_fdf.pcapng"
    done = tshark.run("-r", path, "-q", "-z", "yapp,check,crc=0,dropped=71", "-z", "yapp,faults", check=False)
    is_refused = tshark.version() >= (4, 6)
    assert f"YAPP faults: {'UNKNOWN, not all packets were decoded, 0 in' if is_refused else 1}" in done.stdout
    assert done.returncode == (20 if is_refused else 0) and ("this Wireshark does not dissect 72 packets" in done.stdout) == is_refused
