# SPDX-License-Identifier: GPL-2.0-or-later
"""What was measured, as text: docs/BENCH.md.  Results are { title of a work: { peer: list of Usage, or why it has none } }."""
import statistics
import typing

import works

NAMES = {"none": "none", "isotp": "ISO-TP", "floor": "floor", "hand": "by hand", "script": "script", "list": "CAN list",
         "one": "one interface", "before": "before", "now": "now"}
STEPS = {"reassembly": "reassembly and CRC", "values": "values, faults", "history": "history", "info": "text of Info"}
MEMORY = (works.LIST, works.FILTER, works.VERBOSE, works.VALUES, works.TABLES)
MEGABYTE = 1e6

WHOLE = """\
# How fast it is

Written by `make bench`: medians of the CPU time of whole processes, user and system, and of their most memory; each row and
its peers in turns. None: tshark without the plugin. ISO-TP: tshark's own reassembly in C. Floor: the least that a Lua
dissector can do (`tests/bench/floor.lua`). By hand: a Lua dissector for this one message, that reassembles, checks the CRC and
has the same items, without anything else (`tests/bench/by_hand.lua`). Script: python-can and a decoder by hand, of a log
(`tests/bench/peer.py`). One interface: the same messages in a pcapng file of one interface, where the row's has two, whose
frames come in turns.

{about}
## Ratios

{ratios}
## CPU

Median (least .. most).

{seconds}
{reasons}
## Memory

Of `-T fields` and `-z` against the packet list of none and ISO-TP.

{memory}
## Long captures

{long}
## Where the time of one message goes

{where}"""


class Usage(typing.NamedTuple):
    cpu: float  # seconds, user and system
    memory: float  # bytes, the most


def amounts(results, title, peer, what="cpu"):
    """The measured values; empty where there are none."""
    found = results.get(title, {}).get(peer, ())
    return [] if isinstance(found, str) else [getattr(one, what) for one in found]


def median(results, title, peer, what="cpu"):
    """The median, None where nothing was measured."""
    values = amounts(results, title, peer, what)
    return statistics.median(values) if values else None


def ratio(a, b):
    return a / b if a is not None and b else None


def difference(a, b):
    return a - b if a is not None and b is not None else None


def shown(value, form="{:.2f}"):
    return "" if value is None else form.format(value)


def spread(values, scale=1.0):
    """Median, least and most."""
    if not values:
        return ""
    return "{:.2f} ({:.2f} .. {:.2f})".format(*(f(values) / scale for f in (statistics.median, min, max)))


def why_not(results, title, peers):
    """Why one of the peers has no value here; None where all have."""
    found = results.get(title)
    if found is None:
        return "not asked for"
    return next((found[peer] for peer in peers if isinstance(found.get(peer), str)), None)


def verdict(value, limit):
    """Whether a target is met; a value that is shown as the limit meets it."""
    return "" if value is None else "yes" if round(value, 2) <= limit else "no"


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def peers_of(results):
    return [peer for peer in NAMES if any(peer in found for found in results.values() if isinstance(found, dict))]


# Ratios ----------------------------------------------------------------------------------------------------------

def ratio_row(results, work, peers):
    target, title = work.target, work.title
    why = why_not(results, title, ["now", target.peer])
    values = {peer: ratio(median(results, title, "now"), median(results, title, peer)) for peer in peers}
    limit = f"<= {target.limit:g}x {NAMES[target.peer]}"
    value = values[target.peer]
    if target.difference:
        value = difference(median(results, title, "now"), median(results, title, target.peer))
        values = {target.peer: value}
        limit = f"<= +{target.limit:g} s"
    form = "{:+.2f} s" if target.difference else "{:.2f}"
    return [title, *(shown(values.get(peer), form) for peer in peers), limit,
            f"not measured: {why}" if why else verdict(value, target.limit)]


def ratios(results, all_works):
    peers = [peer for peer in peers_of(results) if peer != "now"]
    return table(["work", *(f"now / {NAMES[peer]}" for peer in peers), "target", "met"],
                 [ratio_row(results, work, peers) for work in all_works if work.target])


def seconds(results, all_works):
    peers = peers_of(results)
    return table(["seconds", *(NAMES[peer] for peer in peers)],
                 [[work.title, *(spread(amounts(results, work.title, peer)) for peer in peers)] for work in all_works])


def reasons(results):
    """Who was not measured in which works, and why."""
    found = {}
    for title, peers in results.items():
        for peer, why in peers.items():
            if isinstance(why, str):
                found.setdefault((peer, why), []).append(title)
    return "".join(f"- not measured: {NAMES.get(peer, peer)}: {why} ({'; '.join(titles)})\n"
                   for (peer, why), titles in found.items())


# Memory ----------------------------------------------------------------------------------------------------------

def over_none(results, title, peer):
    """Bytes more than tshark without the plugin; what is missing of that or of ISO-TP, a packet list stands for."""
    if peer == "isotp" and peer not in results.get(title, ()):
        title = works.LIST
    none = title if "none" in results.get(title, ()) else works.LIST
    return difference(median(results, title, peer, "memory"), median(results, none, "none", "memory"))


def memory(results):
    rows, peers = [], [peer for peer in ("isotp", "before", "now") if peer in peers_of(results)]
    for title in (title for title in MEMORY if title in results):
        why = why_not(results, title, ["now", "isotp", "none"]) or why_not(results, works.LIST, ["isotp", "none"])
        over = {peer: over_none(results, title, peer) for peer in peers}
        rows.append([title, *(shown(ratio(over[peer], MEGABYTE), "{:.1f}") for peer in peers),
                     f"not measured: {why}" if why else verdict(ratio(over["now"], over["isotp"]), 1.0)])
    return table(["memory over none, MB", *(NAMES[peer] for peer in peers), "<= ISO-TP"], rows)


def growth_row(results, peer, is_judged):
    cpu = ratio(median(results, works.LONG_LIST, peer), median(results, works.LONG_LIST, f"{peer} short"))
    most = {ending: difference(median(results, works.LONG_LIST, f"{peer}{ending}", "memory"),
                               median(results, works.LONG_LIST, f"none{ending}", "memory")) for ending in ("", " short")}
    cpu, memory_ = (ratio(value, works.LONGER) for value in (cpu, ratio(most[""], most[" short"])))
    return [NAMES[peer], shown(cpu), shown(memory_),
            " / ".join((verdict(cpu, 1.05), verdict(memory_, 1.0))) if is_judged and cpu else ""]


def long_captures(results, lines):
    """lines: of the long candump log."""
    if works.LONG_LIST not in results:
        return "Not measured: only with LONG=1.\n"
    peers = [peer for peer in ("none", "isotp", "before", "now") if peer in results[works.LONG_LIST]]
    text = table(["ten times the frames: a frame takes", "CPU, times", "memory over none, times", "<= 1.05 / <= 1.0"],
                 [growth_row(results, peer, peer == "now") for peer in peers])
    each = ratio(over_none(results, works.LONG_LOG, "now"), lines)
    cpu, most = (ratio(*(median(results, works.LONG_CONVERT, peer, what) for peer in ("now", "now short")))
                 for what in ("cpu", "memory"))
    text += "\n" + table(["ten times the frames", "CPU of a frame, times", "memory, times"],
                         [[works.LONG_CONVERT.rpartition(",")[0], shown(ratio(cpu, works.LONGER)), shown(most)]])
    return text + "\n" + table(["memory over none, bytes a line", "now", "<= 120"],
                               [[works.LONG_LOG, shown(each, "{:.0f}"), "" if each is None else verdict(each, 120)]])


# Where the time goes ---------------------------------------------------------------------------------------------

def steps(times):
    """Seconds of each step by itself.

    times  list of { step: seconds with all before it }, as parts.lua prints them"""
    names = ["file", *STEPS]
    middle = {name: statistics.median(one[name] for one in times) for name in names}
    return {name: max(0.0, middle[name] - middle[before]) for before, name in zip(names, names[1:])}


def where(results, pure, messages):
    """The time of one message in a packet list, as rows of text and microseconds.

    pure  from steps, empty where the pure parts could not be measured"""
    none, empty, floor, asked, now = (median(results, works.LIST, peer) for peer in ("none", "empty", "floor", "asked", "now"))
    start = difference(median(results, works.START, "now"), median(results, works.START, "none"))
    if None in (none, empty, floor, asked, now, start):
        return []
    rows = [("tshark without the plugin", none), ("calls of a dissector in Lua", empty - none),
            ("id, number, bytes, Protocol, Info: the floor", floor - empty),
            ("where a frame lies, how long it was, column Source", asked - floor),
            *((f"{STEPS[step]}, in plain Lua", value) for step, value in pure.items()),
            ("loading the plugin, its share", start)]
    rest = now - sum(value for _, value in rows)
    rows += [("the rest: what joins these, and that Lua shares the caches", rest), ("all", now)]
    return [(text, value / messages * 1e6) for text, value in rows]


REMAINS = """\
Above the floor remain {above:.1f} µs a message. {pure:.1f} µs of them are the protocol: five frames are put together, 32 bytes
go through a CRC that Lua does not have, and values, faults and history are worked out in the order of the capture, because
the Info column, an expert item or a statistic may need any of them. {asked:.1f} µs are asked of Wireshark, which alone knows
whether a frame is cut or lies behind another in its packet, and the column Source. The rest joins these: for each frame its
bus, id, open message and texts are looked up. And it is what the protocol takes longer here than in plain Lua, where it has
the processor's caches to itself.
"""


def where_text(results, pure, messages):
    rows = where(results, pure, messages)
    if not rows:
        return "Not measured: " + (why_not(results, works.LIST, ["none", "empty", "floor", "asked", "now"]) or "no start") + "\n"
    text = table(["of a message in a packet list", "µs"], [[name, f"{value:.1f}"] for name, value in rows])
    if not pure:
        return text
    value = dict(rows)
    floor = sum(one for _, one in rows[:3])
    return text + "\n" + REMAINS.format(above=value["all"] - floor, asked=rows[3][1],
                                        pure=sum(one for _, one in rows[4:4 + len(pure)]))
