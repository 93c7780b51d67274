#!/usr/bin/env python3
"""The text beside each capture, NAME.expected: what tshark shows of it in the fields of yapp and taurus, and in Info.

    expected.py             writes all of them anew; look at the difference before it is committed
    expected.py NAME ...    writes these

It is the output of tshark -r NAME.pcap, with the options that NAME.frames names, -T fields -e every public field; as
one line for each frame and one for each field of it, without flags that are not set.  Doubles are cut to seven digits
and flags are 1, since versions print them differently.
"""
import functools
import pathlib
import sys

FOLDER = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent / "tests/e2e")]
import make  # noqa: E402
import model  # noqa: E402
import tshark  # noqa: E402

TAURUS = model.filters()
PRESENT = {"yapp.fragments", *model.EXPERTS, *(name for name, kind in TAURUS.items() if kind == "NONE")}
FIELDS = [*(f"yapp.{name}" for name in model.YAPP), *TAURUS, *model.EXPERTS]
ERROR = "_ws.lua.error"
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
    return model.number(text) if kind == "DOUBLE" else text


def shown(capture, *options):
    """Each frame that has YAPP: {"frame": number, "info": text, filter name: [values]}.

    No dissector may have failed in Lua."""
    frames = []
    names = ["frame.number", column("Info"), ERROR, *FIELDS]
    for number, text, error, *values in tshark.fields(capture, names, *options):
        assert not error, f"frame {number}: {error}"
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


@functools.lru_cache(None)
def capture_shown(name, passes):
    """The same for a capture of this folder, with the options that its text names."""
    return shown(make.capture(name)[0], *PASSES[passes], *make.read(name).options)


if __name__ == "__main__":
    for one in sys.argv[1:] or make.names():
        (FOLDER / f"{one}.expected").write_text(as_text(capture_shown(one, "-2")))
