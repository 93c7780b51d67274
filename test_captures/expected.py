#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The text beside each capture, NAME.expected: what tshark shows of it in the fields of yapp and taurus, and in Info.

    expected.py             writes all of them anew, less those of BY_HAND and SWEPT; look at the difference before it is committed
    expected.py NAME ...    writes these

It is the output of tshark -r NAME.pcap, with the options that NAME.frames names, -T fields -e every public field; as
one line for each frame and one for each field of it, without flags that are not set.  Doubles are cut to seven digits
and flags are 1, since versions print them differently.
"""
import atexit
import functools
import itertools
import pathlib
import re
import shutil
import sys
import xml.etree.ElementTree

FOLDER = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent / "tests/e2e")]
import levels  # noqa: E402
import make  # noqa: E402
import model  # noqa: E402
import tshark  # noqa: E402

TAURUS = model.filters()
PRESENT = {"yapp.fragments", *model.EXPERTS, *(name for name, kind in TAURUS.items() if kind == "NONE")}
FIELDS = [*(f"yapp.{name}" for name in model.YAPP), *TAURUS, *model.EXPERTS]
FRAME_NUMBERS = [f"yapp.{name}" for name, kind in model.YAPP.items() if kind == "FRAMENUM"]
BY_HAND = {"remote_frames"}  # two passes take its remote frames for data
SWEPT = {"fault_flags"}  # what the model proves of each message, once more as a sample: without a text
PASSES = {"one pass": (), "-2": ("-2",), "-2 -Y": ("-2", "-Y", "yapp")}


def column(name):
    """The field of a column."""
    return f"_ws.col.{name if tshark.version() < (4, 2) else name.lower()}"


def plain(name, text):
    """A value, the same in every version."""
    if name in PRESENT:
        return "1"
    kind = TAURUS.get(name)
    if kind == "BOOLEAN":
        return "1" if tshark.truth(text) else "0"
    return model.number(text) if kind == "DOUBLE" else text.replace("\\\\", "\\")  # from 4.2 on tshark escapes backslashes


def shown(capture, *options, also=()):
    """Each frame that has YAPP: {"frame": number, "info": text, filter name: [values]}.

    also: fields that are asked for and not shown."""
    frames = []
    also = [*also, *tshark.tells_remote()]
    for number, text, *values in tshark.fields(capture, ["frame.number", column("Info"), *FIELDS, *also], *options):
        frame = {name: [plain(name, one) for one in value.split(",")] for name, value in zip(FIELDS, values) if value}
        if frame:
            # From 4.2 on tshark escapes the backslashes of a column.
            frames.append({"frame": int(number), "info": text.replace("\\\\", "\\"), **frame})
    return frames


def as_text(frames):
    lines = []
    for frame in frames:
        lines.append(f"frame {frame['frame']}: {frame['info']}")
        for name in FIELDS:
            values = frame.get(name, [])
            if TAURUS.get(name) != "BOOLEAN" or "1" in values:
                lines.extend([f"    {name} {', '.join(values)}"] if values else [])
    return "".join(line + "\n" for line in lines)


# What one pass can show ------------------------------------------------------------------------------------------

# Only what comes later says that a Start cut nothing off, where a capture does not tell its buses apart, and that a frame
# came twice, which the CRC proves.
KNOWN_LATER = {"two_buses_unnamed": 2, "extra_middle": 1}  # so many frames at the end show all in one pass


def blocks(text):
    return re.split(r"(?m)^(?=frame )", text)[1:]


def without_forward_links(text):
    """What one pass can show: a frame cannot yet know where its message ends, nor how many parts it has."""
    kept = []
    for block in blocks(text):
        number = re.match(r"frame (\d+)", block)[1]
        link = re.search(r"    yapp.reassembled.in (\d+)\n", block)
        if link and link[1] != number:
            block = block.replace(link[0], "").replace(f"  [Reassembled in #{link[1]}]", "")
        if "\n    " in block:
            kept.append(re.sub(r"(  fragment \d+) of \d+", r"\1", block))
    return "".join(kept)


def comparison(name, passes, frames):
    """What these passes have to show of a capture, and what is shown, as texts to compare."""
    wanted, text = make.texts()[name].with_suffix(".expected").read_text(), as_text(frames)
    if passes == "one pass":
        wanted, text = without_forward_links(wanted), without_forward_links(text)
        if name in KNOWN_LATER:
            wanted, text = (blocks(one)[-KNOWN_LATER[name]:] for one in (wanted, text))
    return wanted, text


# The captures of this folder -------------------------------------------------------------------------------------

# Beside another controller with its ID, a source has its name in Info: Motor Data 0x210 (if3), or ID 0x300 (if3).
NAMED_SOURCE = re.compile(r"(?<!ID) 0x[0-9a-f]+ \([^()]+\)|(?<=0x...) \([^()]+\)")


def as_alone(frame, before):
    """A frame of a capture with one bus, as it is without the frames before it and without controllers beside it."""
    def number(match):
        return match[1] + str(int(match[2]) - before)

    info = NAMED_SOURCE.sub("", frame["info"])
    return {**frame, "frame": frame["frame"] - before, "info": re.sub(r"(#|\bframe )(\d+)", number, info),
            **{name: [str(int(one) - before) for one in frame[name]] for name in FRAME_NUMBERS if name in frame}}


def takes_all(name):
    return "yapp.all_extended:TRUE" in make.read(name).options


@functools.lru_cache(None)
def together(everything):
    """Captures one after the other in one file, each from an interface of its own: its path, the options of all, and of each its
    first frame, less one.  everything: those that need yapp.all_extended, or the others."""
    sources = {name: make.read(name) for name in make.names() if takes_all(name) == everything}
    folder = tshark.writable_folder()
    atexit.register(shutil.rmtree, folder)
    path = folder / "together.pcapng"
    path.write_bytes(make.pcapng(*sources.values()))
    options = [word for pair in dict.fromkeys(tuple(one.options) for one in sources.values()) for word in pair]
    counts = itertools.accumulate((len(one.packets) for one in sources.values()), initial=0)
    return path, options, dict(zip(sources, counts))


@functools.lru_cache(None)
def shown_together(everything, passes):
    """Captures in one run of tshark: {name: its frames}."""
    path, options, firsts = together(everything)
    frames = shown(path, *PASSES[passes], *options, also=["frame.interface_id", "sll.ifindex"])
    return {name: [as_alone(frame, before) for frame in frames if before < frame["frame"] <= before + len(make.read(name).packets)]
            for name, before in firsts.items()}


@functools.lru_cache(None)
def trees_together(everything, passes):
    path, options, _ = together(everything)
    return xml.etree.ElementTree.fromstring(tshark.run(*PASSES[passes], "-r", path, *options, "-T", "pdml").stdout).findall("packet")


def trees(name, passes="one pass"):
    """The packets of a capture as PDML has them, among all others."""
    before = together(takes_all(name))[2][name]
    return trees_together(takes_all(name), passes)[before:before + len(make.read(name).packets)]


@functools.lru_cache(None)
def capture_shown(name, passes):
    """What is shown of a capture of this folder, with the options that its text names.

    All captures are shown in few runs; where the frames of this one are right among the others', that is enough.  If not it is
    shown alone, and that counts: a first pass has no fields to tell the interfaces apart, so it may take something from its
    neighbours.  In test-all each is shown alone."""
    options = make.read(name).options
    if not levels.ALL:
        frames = shown_together(takes_all(name), passes)[name]
        wanted, text = ("", "") if name in SWEPT else comparison(name, passes, frames)
        if wanted == text:
            return frames
    return shown(make.capture(name)[0], *PASSES[passes], *options)


if __name__ == "__main__":
    for one in sys.argv[1:] or set(make.names()) - BY_HAND - SWEPT:
        options = make.read(one).options
        make.texts()[one].with_suffix(".expected").write_text(as_text(shown(make.capture(one)[0], "-2", *options)))
