# SPDX-License-Identifier: GPL-2.0-or-later
"""Random CAN captures against their truth, in one pass and in two.

    python3 -m pytest tests/e2e/test_can_soak.py        some small captures; more with YAPP_LEVEL=all
    make soak                                           1,000 captures, about a million frames: the same with
                                                        YAPP_SOAK_CAPTURES=1000 YAPP_SOAK_FRAMES=1000

YAPP_SEED chooses other ones.  A failure says which seed, layout and frame: make_one(seed, layout, wide).write(path)
gives that capture.
"""
import collections
import os

import pytest

import can_generator
import levels
import model
import tshark
from expected import plain

CAPTURES = int(os.environ.get("YAPP_SOAK_CAPTURES", levels.size("40", "320")))
FRAMES = int(os.environ.get("YAPP_SOAK_FRAMES", "50"))
SEED = os.environ.get("YAPP_SEED", "1")
KINDS = [(layout, wide) for layout in can_generator.LAYOUTS for wide in (False, True)]
KINDS = levels.size([kind for at, kind in enumerate(KINDS) if at % 4 in (0, 3)], KINDS)  # each layout and both, once
PER_FILE = min(can_generator.SLOTS, max(1, CAPTURES // len(KINDS)), max(1, 20_000 // FRAMES))
FILES = -(-CAPTURES // PER_FILE)

EXPERTS = ["crc.bad", "fragment.orphan", "fragment.incomplete", "fragment.overrun", "size.mismatch", "id.unknown",
           "reserved.nonzero", "can.ctrl.invalid", "truncated", "fragment.duplicate"]
KNOWN_LATER = {"fragment.duplicate"}  # of a Middle: when the message ends

TAURUS = [name for name in model.filters() if name.count(".") > 1]  # the values
FIELDS = ["frame.number", "yapp.id", "yapp.can.ctrl", "yapp.crc.status", "yapp.reassembled.in", "yapp.fragment", "yapp.padding",
          "yapp.fragment.data", "yapp.payload", "yapp.undecoded", *(f"yapp.{name}" for name in EXPERTS), *TAURUS]


def key(frame):
    """What the frames of a message share: the id without CAN CTRL."""
    return frame.can_id & ~(0xF << 14)


class Comparison:
    """What tshark shows of a capture, held against the truth."""

    def __init__(self, capture, rows, two_passes=False):
        self.capture, self.two_passes, self.problems = capture, two_passes, []
        self.several = capture.layout in can_generator.SEVERAL_BUSES
        self.guessed = self.unknowable() if two_passes else set()
        self.rows = {int(row["frame.number"]): row for row in rows}

    def expect(self, number, what, expected, shown):
        if expected != shown:
            self.problems.append(f"frame {number}: {what}: expected {expected}, shown {shown}")

    def unknowable(self):
        """Keys of which a first pass without fields (tshark -2) cannot know enough, so that links to what comes are a guess:
        frames of zeros may be remote frames, and the first Start of an unknown message that numbers its messages has
        no id."""
        return {key(frame) for frame in self.capture.frames
                if not frame.kept.strip(b"\0") or
                frame.can_id & 0xFF and not can_generator.kind_of(frame.can_id >> 18)}

    def run(self):
        unsure = {key(self.capture.frames[number - 1]) for number, verdict in self.capture.verdicts.items() if verdict.unsure}
        for number, verdict in self.capture.verdicts.items():
            if key(self.capture.frames[number - 1]) not in unsure:
                self.strictly(number, verdict, self.rows.get(number, collections.defaultdict(str)))
        return self.problems

    def strictly(self, number, verdict, row):
        frame = self.capture.frames[number - 1]
        self.expect(number, "is YAPP", verdict.ours, row["yapp.id"] != "")
        if not verdict.ours:
            return
        self.expect(number, "ID", frame.can_id >> 18, int(row["yapp.id"] or "-1", 0))
        self.expect(number, "CTRL", str(verdict.ctrl), row["yapp.can.ctrl"])
        later = set() if self.two_passes else KNOWN_LATER
        self.expect(number, "experts", verdict.experts - later, {name for name in EXPERTS if row[f"yapp.{name}"]} - later)
        shown = row["yapp.crc.status"]
        self.expect(number, "CRC status", "" if verdict.status is None else str(verdict.status),
                    shown if shown != "2" or verdict.status is not None else "")
        self.numbers(number, verdict, row)
        if verdict.ctrl == 2:
            self.expect(number, "fragment data", frame.kept.hex(), row["yapp.fragment.data"])
        if verdict.payload is not None and frame.captured is None and verdict.status != 2:
            self.expect(number, "padding", verdict.padding, len(row["yapp.padding"]) // 2)
            self.payload(number, verdict.payload, row, is_good=verdict.status != 0)

    def numbers(self, number, verdict, row):
        if verdict.members and number == verdict.members[-1]:
            self.expect(number, "fragments", verdict.members,
                        [int(text) for text in row["yapp.fragment"].split(",") if text])
        if self.two_passes and number != verdict.reassembled_in and (
                key(self.capture.frames[number - 1]) in self.guessed or
                self.several and self.cannot_know(verdict, row)):
            return
        if verdict.reassembled_in and (self.two_passes or number == verdict.reassembled_in):
            self.expect(number, "reassembled in", str(verdict.reassembled_in),
                        row["yapp.reassembled.in"])

    def cannot_know(self, verdict, row):
        """Whether a link to a frame that will come is a guess: the first pass could not tell the buses apart but by the
        CRC, and an End of the other bus may have the same bytes."""
        shown = row["yapp.reassembled.in"]
        if not shown:
            return True
        ends = [self.capture.frames[last - 1].kept for last in (int(shown), verdict.reassembled_in) if last]
        return len(ends) == 2 and (ends[0].startswith(ends[1]) or ends[1].startswith(ends[0]))

    def payload(self, number, payload, row, is_good):
        """A payload that is longer than the catalogue's is decoded unless its CRC is bad."""
        kind = can_generator.kind_of(self.capture.frames[number - 1].can_id >> 18)
        size = can_generator.SIZES[kind] if kind else 0
        if kind and (len(payload) == size or len(payload) > size and is_good):
            expected = model.decode(can_generator.DEFAULT_ID[kind], payload)[0]
            self.expect(number, "undecoded", payload[size:].hex(), row["yapp.undecoded"])
            for name in TAURUS:
                self.expect(number, name, expected.get(name, ""), row[name] and plain(name, row[name]))
        else:
            self.expect(number, "payload", payload.hex(), row["yapp.payload"])


def show(capture, path, *arguments):
    """What tshark shows: a dictionary of texts for each frame."""
    for line in tshark.fields(path, FIELDS + tshark.tells_remote(), *capture.preferences, *arguments):
        yield dict(zip(FIELDS, line))


def make_one(seed, layout, wide):
    return can_generator.capture(seed, layout, wide, situations=PER_FILE, frames=FRAMES)


def compare(seed, layout, wide, capture, path, *arguments):
    comparison = Comparison(capture, show(capture, path, *arguments), "-2" in arguments)
    problems = comparison.run()
    where = f"seed {seed}, {layout}, every extended frame {wide}, {' '.join(arguments) or 'one pass'}"
    assert not problems, f"{where}: {len(problems)} differences\n" + "\n".join(problems[:20])


@pytest.mark.parametrize("number", range(FILES))
def test_random_captures(number, folder):
    layout, wide = KINDS[number % len(KINDS)]
    seed = f"{SEED}.{number}"
    capture, path = make_one(seed, layout, wide), folder / "random.pcap"
    capture.write(path)
    compare(seed, layout, wide, capture, path)
    capture = capture.without_remote_frames()
    capture.write(path)
    compare(seed, layout, wide, capture, path, "-2")


@pytest.mark.parametrize("layout", levels.few(can_generator.LAYOUTS, ["interfaces", "merged interface"]))
def test_filters(layout, folder):
    """A display filter and a read filter do not change what a frame is."""
    wide = layout not in can_generator.MERGED
    seed = f"{SEED}.filters"
    capture, path = make_one(seed, layout, wide), folder / "random.pcap"
    capture.write(path)
    if levels.ALL or layout == "interfaces":
        compare(seed, layout, wide, capture, path, "-Y", "yapp")
    capture = capture.without_remote_frames()
    capture.write(path)
    compare(seed, layout, wide, capture, path, "-2", "-Y", "yapp")

    def good_messages(option):
        names = ["yapp.id", "yapp.payload", *TAURUS]
        rows = show(capture, path, "-2", option, "yapp")
        return collections.Counter(tuple(row[name] for name in names) for row in rows if row["yapp.crc.status"] == "1")

    # A read filter renumbers the frames: then the file tells no bus, so the CRC does, which may miss some, and invents none.
    found, expected = (good_messages(option) for option in ("-R", "-Y"))
    if layout in can_generator.SEVERAL_BUSES:
        assert found and not found - expected
    else:
        assert found == expected


@pytest.mark.parametrize("layout", levels.few(can_generator.LAYOUTS, ["merged interface"]))
def test_the_packet_list_says_what_a_tree_says(layout, folder):
    """The list builds no tree, so it knows less: what that changes, its interface or a flag, must not show."""
    seed, wide = f"{SEED}.list", layout not in can_generator.MERGED
    capture, path = make_one(seed, layout, wide).without_remote_frames(), folder / "random.pcapng"
    capture.write(path)
    listed = tshark.run("-r", path, *capture.preferences, "-o", 'gui.column.format:"No.","%m","Info","%i"').stdout
    shown = tshark.fields(path, ["frame.number", "_ws.col.Info", "frame.interface_id"], *capture.preferences)
    assert [line.split() for line in listed.splitlines()] == [[number, *info.split()] for number, info, _ in shown]


@levels.each_once
@pytest.mark.parametrize("option", [(), ("-o", "yapp.all_extended:TRUE"), ("-d", "can.subdissector,yapp_all")])
@pytest.mark.parametrize("layout", levels.few(can_generator.LAYOUTS, ["interfaces", "merged interface"]))
def test_statistics_without_a_tree_say_what_those_with_one_say(layout, option, folder):
    """Alone they have neither a tree nor a column, which tell CAN ids and remote frames."""
    capture, path = make_one(f"{SEED}.statistics", layout, layout not in can_generator.MERGED), folder / "random.pcapng"
    capture.write(path)

    def events(output):
        done = tshark.run(output, "-r", path, *capture.preferences, *option, "-z", "yapp,events,json", check=False)
        said = [line for line in done.stderr.splitlines() if line.startswith("yapp:")]
        return [line for line in done.stdout.splitlines() if line.startswith('{"kind"')] + said

    alone = events("-q")
    assert alone and alone == events("-V")
