# SPDX-License-Identifier: GPL-2.0-or-later
"""The command: yapp-tables convert, report; install, check, uninstall."""

from __future__ import annotations

import argparse
import glob
import os
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from . import fleet, install
from .convert import KINDS, Job, made_by, writer
from .errors import SetupError, YappError, need
from .fleet import Failure, Progress
from .flight import read_flight
from .results import Results
from .tshark import Tshark

FAILED, REFUSED, INCOMPLETE = 1, 2, 3
# What -o of `report` takes for a preference, and not for the page.
PREFERENCE = re.compile(r"[a-z0-9_-]+(\.[a-z0-9_.-]+)+:|uat:")
CAPTURES = "files, patterns such as 'flights/**/*.pcapng', - for a list from stdin"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command. Returns its exit code.

    0 all done, 1 a capture failed, 2 nothing could be done, 3 done, but not all that looks like YAPP was decoded.
    """
    given = _parser().parse_args(arguments)
    try:
        code: int = given.run(given)
        return code
    except SetupError as error:
        print(f"yapp-tables: {error}", file=sys.stderr)
        return REFUSED
    except (YappError, OSError) as error:
        print(f"yapp-tables: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="yapp-tables", description="Captures of YAPP and Taurus as tables.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "-o", dest="options", action="append", default=[], metavar="NAME:VALUE", help="a preference for tshark"
    )
    common.add_argument("--filter", metavar="EXPRESSION", help="a display filter: only these messages")
    common.add_argument("--plugin", metavar="PATH", help="yapp.lua, where the plugin is not installed")
    common.add_argument("--tshark", metavar="PATH", help="the program, where it is not in PATH")

    convert = commands.add_parser("convert", parents=[common], help="captures to a data set")
    convert.add_argument("captures", nargs="+", metavar="CAPTURE", help=CAPTURES)
    convert.add_argument("--to", choices=KINDS, required=True)
    convert.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    convert.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="work on this Dask cluster")
    convert.add_argument(
        "--jobs", type=_positive, default=os.cpu_count() or 1, metavar="N", help="captures at a time on this machine"
    )
    convert.add_argument("--strict", action="store_true", help="end with 1 where not all was decoded, not with 3")
    convert.set_defaults(run=_convert)

    report = commands.add_parser("report", parents=[common], help="one page of a capture, -o PAGE.html")
    report.description = (
        "One page of a capture that opens offline. -o PAGE.html names it, beside preferences given with -o."
    )
    report.add_argument("capture", type=Path, metavar="CAPTURE")
    report.set_defaults(run=_report)

    for what, text in (
        ("install", "the plugin, live ports and profile into Wireshark"),
        ("check", "what is installed in Wireshark, and what is wrong with it"),
        ("uninstall", "what was installed out of Wireshark"),
    ):
        command = commands.add_parser(what, help=text)
        command.set_defaults(run=_install, what=what, purge=False)
    command.add_argument("--purge", action="store_true", help="what you changed, too")
    return parser


def _install(given: argparse.Namespace) -> int:
    return install.run(given.what, given.purge, install.own_program())


def _report(given: argparse.Namespace) -> int:
    pages = [text for text in given.options if not PREFERENCE.match(text)]
    if len(pages) > 1:
        raise SetupError(f"one page at a time, not {' and '.join(pages)}")
    given.options = [text for text in given.options if text not in pages]
    page = Path(pages[0]) if pages else given.capture.with_suffix(".html")
    if not page.parent.is_dir():
        raise SetupError(f"{page} cannot be written: no folder {page.parent}")
    write_report = need(f"{__package__}.report", "report").write_report
    tshark = _tshark(given)
    flight = read_flight(given.capture, tshark)
    _say(flight.left_out)
    try:
        write_report(flight, page, tshark.begin(given.capture))
    except OSError as error:
        raise SetupError(f"{page} cannot be written: {error.strerror}") from error
    return FAILED if flight.partial else INCOMPLETE if flight.left_out else 0


def _say(complaints: Iterable[str]) -> None:
    for text in complaints:
        print(f"yapp-tables: {text}", file=sys.stderr)


def _positive(text: str) -> int:
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 on")
    return int(text)


def _tshark(given: argparse.Namespace) -> Tshark:
    return Tshark(given.tshark, given.plugin and os.path.abspath(given.plugin), tuple(given.options), given.filter)


def _captures(patterns: Iterable[str]) -> list[Path]:
    """The files that are meant, absolute, in order, each once; SetupError where a pattern finds none."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        if pattern == "-":
            names = [line for line in sys.stdin.read().splitlines() if line.strip()]
        elif os.path.exists(pattern) or not glob.has_magic(pattern):
            names = [pattern]
        else:
            names = sorted(name for name in glob.glob(pattern, recursive=True) if os.path.isfile(name))
            if not names:
                raise SetupError(f"no file matches {pattern}")
        found |= dict.fromkeys(Path(os.path.abspath(name)) for name in names)
    if not found:
        raise SetupError("no captures: the list is empty")
    return list(found)


def _convert(given: argparse.Namespace) -> int:
    captures = _captures(given.captures)
    writer(given.to)
    tshark = _tshark(given)
    catalogue, _ = tshark.catalogue()
    made = made_by(tshark, catalogue)
    results = Results(given.out.resolve(), given.to)
    results.open(captures, made)
    try:
        jobs, failures, incomplete = [], [], 0
        for capture, name in results.names(captures).items():
            current = results.current(name, capture, made)
            if current is None:
                jobs.append(Job(capture, name, results, tshark, made))
                continue
            _say(f"{capture}: {text}" for text in current.lacks)
            incomplete += bool(current.lacks)
            if current.partial:
                failures.append(Failure(capture, f"read in part: {current.partial}"))
        if len(jobs) < len(captures):
            print(f"{len(captures) - len(jobs)} of {len(captures)} captures are up to date", file=sys.stderr)
        with fleet.executor(given.scheduler, given.jobs) as pool:
            progress = Progress.of(jobs)
            failures += fleet.run(jobs, pool, progress)
    finally:
        results.close()
    failed = _tell(failures, len(captures), results.out / "failures.csv")
    if incomplete := incomplete + progress.incomplete:
        _say([f"{incomplete} of {len(captures)} captures were not decoded completely: the lines above say what to set"])
        return failed or (FAILED if given.strict else INCOMPLETE)
    return failed


def _tell(failures: list[Failure], count: int, path: Path) -> int:
    """List the captures that failed; returns the exit code."""
    try:
        fleet.write_failures(path, failures)
    except OSError as error:
        raise YappError(f"{path} cannot be written: {error.strerror}") from error
    if failures:
        print(f"yapp-tables: {len(failures)} of {count} captures failed: {path}", file=sys.stderr)
    return FAILED if failures else 0
