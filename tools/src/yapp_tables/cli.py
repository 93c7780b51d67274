# SPDX-License-Identifier: GPL-2.0-or-later
"""The command: yapp-tables convert, report, case, diff, trend, baseline; install, check, uninstall."""

import argparse
import gc
import logging
import os
import signal
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import NoReturn

# Each command imports its own: Arrow and numpy take longer than most of the rest.
from . import __version__, install
from .errors import SetupError, YappError, count_of
from .scratch import write_whole
from .tshark import Tshark, stop

FAILED, REFUSED, INCOMPLETE = 1, 2, 3
# Two examples of each command, behind its --help.
EXAMPLES = {
    "convert": ("'flights/**/*.pcapng' --to parquet --out data", "bench.pcapng --with stand.csv --to csv --out bench"),
    "report": ("run.pcapng --out flight.html", "run.pcapng --rules flight.rules"),
    "case": ("run.pcapng --out case.zip", "run.pcapng 2 -o yapp.motor_ids:0x210,0x211 --out case.zip"),
    "diff": ("before.pcapng after.pcapng", "'old/*.pcapng' 'new/*.pcapng' --rules flight.rules --junit diff.xml"),
    "trend": ("data", "data --out trend.html"),
    "baseline": ("'good/*.pcapng' --out flight.rules", "good --out flight.rules -o yapp.motor_ids:0x210,0x211"),
    "install": ("", "&& yapp-tables check"),
    "check": ("", "|| yapp-tables install"),
    "uninstall": ("", "--purge"),
}


def run() -> NoReturn:
    """Run the command as a process of its own: these settings save 0.2 s of CPU."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small here
    gc.set_threshold(100_000)  # imports leave no garbage
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)
    os._exit(main())  # numpy and Arrow need not be taken apart


def _stop(number: int, _: object) -> NoReturn:
    """End what runs; what it left half made is removed on the way out."""
    stop()
    sys.exit(128 + number)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns its exit code: docs/tables.md."""
    given = _parser().parse_args(arguments)
    try:
        code = int(given.run(given) or 0)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # as before "| head -1": nobody reads on
        return FAILED
    except YappError as error:
        _say([str(error)])
        return REFUSED if isinstance(error, SetupError) else FAILED
    except OSError as error:
        _say([f"{error.filename}: {error.strerror}" if error.filename else str(error)])
        return REFUSED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="yapp-tables", description="Captures of YAPP and Taurus as tables.")
    parser.add_argument("--version", action="version", version=f"yapp-tables {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    how = argparse.ArgumentParser(add_help=False)
    how.add_argument("-o", dest="options", action="append", default=[], metavar="NAME:VALUE", help="a preference")
    how.add_argument("-C", dest="profile", metavar="PROFILE", help="a profile of Wireshark's")
    how.add_argument("--filter", metavar="EXPRESSION", help="a display filter: only these messages")
    how.add_argument("--plugin", metavar="PATH", help="yapp.lua, where the plugin is not installed")
    how.add_argument("--tshark", metavar="PATH", help="the program, where it is not in PATH")

    convert = commands.add_parser("convert", parents=[how], help="write captures as a data set")
    convert.add_argument("--to", default="parquet", metavar="KIND", help="parquet, csv, delta, mf4 or mcap")
    convert.add_argument("--out", required=True, metavar="FOLDER", help="of the data set; or a URL, s3://bucket/folder")
    convert.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="work on this Dask cluster")
    convert.add_argument("--jobs", type=int, metavar="N", help="captures at a time on this machine")
    convert.add_argument("--with", dest="bench", metavar="bench.csv", help="a thrust stand's log of this one capture")

    report = commands.add_parser("report", parents=[how], help="write a page about a capture")
    report.add_argument("--out", type=_file, metavar="PAGE.html", help="the page, without it one named as the capture")
    report.add_argument("--rules", type=Path, metavar="FILE", help="rules: their ranges are limits in the pictures")

    case = commands.add_parser("case", parents=[how], help="pack a fault for the vendor: frames, card, page")
    for command in (convert, report):
        command.add_argument("--bitrate", type=int, metavar="500000", help="of the CAN buses: shows their load")
    for command in (report, case):
        command.add_argument("capture", metavar="CAPTURE", help="the file")
    case.add_argument("number", metavar="N", nargs="?", type=int, default=1, help="of the fault, 1 for the first")
    case.add_argument("--out", type=_file, metavar="case.zip", required=True, help="the zip")

    diff = commands.add_parser("diff", parents=[how], help="compare two runs: what got worse, better, or changed")
    diff.add_argument("before", metavar="BEFORE", help="a capture, a folder of them, or a pattern in quotes")
    diff.add_argument("after", metavar="AFTER", help="the same")
    diff.add_argument("--rules", type=Path, metavar="FILE", help="rules that are judged on both, too")
    diff.add_argument("--junit", type=_file, metavar="FILE", help="write the verdict as a JUnit suite")
    diff.add_argument("--json", action="store_true", help="one JSON object a line instead of sentences")
    diff.add_argument("--out", type=_file, metavar="PAGE.html", help="write a page with both, bins side by side")

    trend = commands.add_parser("trend", help="find what drifts over the flights of a data set")
    trend.add_argument("data", metavar="DATA", help="the folder of convert --to parquet")
    trend.add_argument("--json", action="store_true", help="one JSON object a line, for each value of each controller")
    trend.add_argument("--out", type=_file, metavar="PAGE.html", help="write a page with a small picture a value")

    learn = commands.add_parser("baseline", parents=[how], help="learn rules for -z yapp,check from good flights")
    learn.add_argument("--out", type=_file, required=True, metavar="flight.rules", help="the file of rules")
    for command in (convert, learn):
        command.add_argument("captures", nargs="+", metavar="CAPTURE", help="files, folders, or patterns in quotes")

    commands.add_parser("install", help="put the plugin, live ports and profile into Wireshark")
    commands.add_parser("check", help="say what is installed in Wireshark, and what is wrong")
    uninstall = commands.add_parser("uninstall", help="remove from Wireshark what was installed")
    uninstall.add_argument("--purge", action="store_true", help="remove what you changed, too")
    for name, command in commands.choices.items():
        run = RUN.get(name, lambda given: install.run(given.what, getattr(given, "purge", False)))
        command.set_defaults(run=run, what=name)
        lines = "\n".join(f"  yapp-tables {name} {example}".rstrip() for example in EXAMPLES[name])
        command.epilog, command.formatter_class = f"examples:\n{lines}", argparse.RawDescriptionHelpFormatter
    return parser


def _file(text: str) -> Path:
    """Return a file to write. What takes minutes must not fail at the end for a folder that is not there."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is a folder, or in no folder: name a file")
    return path


def _say(texts: Iterable[str]) -> None:
    for text in texts:
        print(f"yapp-tables: {text}", file=sys.stderr)


def _tshark(given: argparse.Namespace) -> Tshark:
    bitrate = getattr(given, "bitrate", None)
    return Tshark(given.tshark, given.plugin, tuple(given.options), given.filter, given.profile, bitrate)


def _refuse_pandas(name: str, *_: object) -> None:
    if name == "pandas":
        raise ImportError(name)


def _convert(given: argparse.Namespace) -> int:
    from .dataset import convert

    # The process is this command's own. What Dask has to say of lost workers it mends itself.
    logging.disable(logging.CRITICAL)
    if given.to != "mf4":  # Arrow imports pandas where it is, which takes as long as a flight of half an hour
        sys.meta_path.insert(0, SimpleNamespace(find_spec=_refuse_pandas))
    how = {name: getattr(given, name) for name in ("to", "jobs", "scheduler", "bench")} | vars(_tshark(given))
    results = convert(given.captures, given.out, **how)
    for result in results:
        partial = f"read in part: {result.partial}" if result.partial else None
        said = (result.failure, partial, *result.lacks, *result.notes)
        _say(f"{result.capture}: {text}" for text in said if text)
    rows, whole = {one.flight_id: sum(one.messages.values()) for one in results}, count_of(len(results), "capture")
    _say([f"{whole}, {count_of(sum(rows.values()), 'row')} in {given.out}"])
    failed = sum(bool(result.failure or result.partial) for result in results)
    lacking = sum(bool(result.lacks) for result in results)
    if failed:
        _say([f"{failed} of {whole} failed: the lines above say why"])
    if lacking:
        _say([f"{lacking} of {whole} not decoded completely: the lines above say what to set"])
    return FAILED if failed else INCOMPLETE if lacking else 0


def _report(given: argparse.Namespace) -> int:
    from .report_page import write_page

    _, flight = write_page(Path(given.capture), given.out, given.rules, _tshark(given))
    _say(f"{flight.name}: {text}" for text in flight.left_out)
    return FAILED if flight.partial else INCOMPLETE if flight.left_out else 0


def _case(given: argparse.Namespace) -> None:
    from .report_page import write_case

    print(f"{given.out}: {write_case(Path(given.capture), given.number, _tshark(given), given.out)}")


def _diff(given: argparse.Namespace) -> int:
    from . import diff
    from .dataset import find

    found = diff.compare(find(given.before), find(given.after), _tshark(given), given.rules)
    _print(given, diff, found)
    if given.junit:
        write_whole(given.junit, diff.junit(found))
    return found.code


def _trend(given: argparse.Namespace) -> None:
    from . import trend

    _print(given, trend, trend.drifts(Path(given.data)))


def _print(given: argparse.Namespace, module: ModuleType, found: object) -> None:
    for line in module.json_lines(found) if given.json else module.lines(found):
        print(line)
    if given.out:
        write_whole(given.out, module.page(found))


def _baseline(given: argparse.Namespace) -> int:
    from . import baseline
    from .dataset import find

    captures = find(given.captures)
    text, left = baseline.learn(captures, _tshark(given))
    write_whole(given.out, text)
    _say([*left, f"{count_of(len(captures), 'flight')} in {given.out}"])
    return INCOMPLETE if left else 0


RUN = {"convert": _convert, "report": _report, "case": _case, "diff": _diff, "trend": _trend, "baseline": _baseline}
