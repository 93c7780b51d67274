# SPDX-License-Identifier: GPL-2.0-or-later
"""The command: yapp-tables convert, prune, report, case, diff, trend, graphs, baseline; install, check, uninstall."""

from __future__ import annotations

import argparse
import logging
import os
import re
import sys
from collections.abc import Iterable, Sequence
from decimal import Decimal
from importlib.abc import MetaPathFinder
from pathlib import Path

from . import __version__, baseline, fleet, graphs, install
from .config import Config, read_fleet
from .convert import KINDS
from .errors import SetupError, YappError, count_of, need
from .scratch import write_whole
from .tshark import Tshark, left_out

FAILED, REFUSED, INCOMPLETE = 1, 2, 3
# Two examples of each command, behind its --help.
EXAMPLES = {
    "convert": ("'flights/**/*.pcapng' --to parquet --out data", "bench.pcapng --with stand.csv --to csv --out bench"),
    "prune": ("--out data", "--to delta --out s3://bucket/lake"),
    "report": ("run.pcapng --out flight.html", "a.pcapng b.pcapng --overlay --rules flight.rules --out both.html"),
    "case": ("run.pcapng --out case.zip", "run.pcapng 2 -o yapp.motor_ids:0x210,0x211 --out case.zip"),
    "graphs": ("run.pcapng", "run.pcapng --out ~/.config/wireshark/profiles/bench"),
    "diff": ("before.pcapng after.pcapng", "'old/*.pcapng' 'new/*.pcapng' --rules flight.rules --junit diff.xml"),
    "trend": ("data", "data --out trend.html"),
    "baseline": ("'good/*.pcapng' --out flight.rules", "'good/*.pcapng' --margin 20% --out flight.rules"),
    "install": ("", "&& yapp-tables check"),
    "check": ("", "|| yapp-tables install"),
    "uninstall": ("", "--purge"),
}
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
        _say([str(error)])
        return REFUSED
    except (YappError, OSError) as error:
        _say([str(error)])
        return FAILED
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="yapp-tables", description="Captures of YAPP and Taurus as tables.")
    parser.add_argument("--version", action="version", version=f"yapp-tables {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    how = argparse.ArgumentParser(add_help=False)
    how.add_argument(
        "-o", dest="options", action="append", default=[], type=_preference, metavar="NAME:VALUE", help="a preference"
    )
    how.add_argument("-C", dest="profile", metavar="PROFILE", help="a profile of Wireshark's")
    how.add_argument("--fleet", metavar="fleet.toml", help="the settings of each aircraft")
    how.add_argument("--filter", metavar="EXPRESSION", help="a display filter: only these messages")
    how.add_argument("--plugin", metavar="PATH", help="yapp.lua, where the plugin is not installed")
    how.add_argument("--tshark", metavar="PATH", help="the program, where it is not in PATH")
    common = argparse.ArgumentParser(add_help=False, parents=[how])
    common.add_argument("captures", nargs="+", metavar="CAPTURE", help=CAPTURES)
    common.add_argument("--strict", action="store_true", help="end with 1 where not all was decoded, not with 3")

    convert = commands.add_parser("convert", parents=[common], help="captures to a data set")
    convert.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="work on this Dask cluster")
    convert.add_argument("--jobs", type=_positive, metavar="N", help="captures at a time on this machine")
    convert.add_argument("--partition", choices=("day", "vehicle"), help="folders below each table of Parquet and CSV")
    convert.add_argument("--with", dest="bench", metavar="bench.csv", help="a thrust stand's log of this one capture")
    convert.set_defaults(run=_convert)
    prune = commands.add_parser("prune", help="flights out of a data set whose captures are gone")
    prune.set_defaults(run=_prune)
    for command in (convert, prune):
        command.add_argument("--to", choices=KINDS, default="parquet")
        command.add_argument("--out", required=True, metavar="FOLDER", help="or a URL, s3://bucket/folder")

    report = commands.add_parser("report", parents=[common], help="a page of a capture, pages of several")
    report.add_argument("--out", metavar="PAGE.html", help="the page; of several captures the folder")
    report.add_argument("--rules", metavar="flight.rules", help="rules: their ranges are limits in the pictures")
    report.add_argument("--overlay", action="store_true", help="lay several flights over each other, on one page")
    report.set_defaults(run=_report)

    one = commands.add_parser("case", parents=[how], help="a fault for the vendor: its frames, card, page, versions")
    one.add_argument("capture", metavar="CAPTURE")
    one.add_argument("number", metavar="N", nargs="?", type=_positive, default=1, help="of the fault, 1 for the first")
    one.add_argument("--out", metavar="case.zip", required=True, help="the zip")
    one.set_defaults(run=_case)

    draw = commands.add_parser("graphs", parents=[common], help="a line of each controller in the profile's graphs")
    draw.add_argument("--out", metavar="FOLDER", help="of a profile; without it the profile YAPP")
    draw.set_defaults(run=_graphs)

    two = commands.add_parser("diff", parents=[how], help="two runs compared: what got worse, better, or is another")
    two.add_argument("before", metavar="BEFORE", help="a capture, a folder of them, or a pattern in quotes")
    two.add_argument("after", metavar="AFTER", help="the same")
    two.add_argument("--rules", metavar="FILE", help="rules that are judged on both, too")
    two.add_argument("--junit", metavar="FILE", help="write the verdict as a JUnit suite")
    two.add_argument("--json", action="store_true", help="one JSON object a line instead of sentences")
    two.add_argument("--out", metavar="PAGE.html", help="write a page with both, bins side by side")
    two.set_defaults(run=_diff)

    drift = commands.add_parser("trend", help="what drifts over the flights of a data set, of each controller")
    drift.add_argument("data", metavar="DATA", help="the folder of convert --to parquet")
    drift.add_argument("--json", action="store_true", help="one JSON object a line, for each value of each controller")
    drift.add_argument("--out", metavar="PAGE.html", help="write a page with a small picture a value")
    drift.set_defaults(run=_trend)

    learn = commands.add_parser("baseline", parents=[common], help="good flights to rules for -z yapp,check")
    learn.add_argument("--out", required=True, metavar="flight.rules", help="the file of rules")
    learn.add_argument("--margin", type=_share, default="10%", metavar="10%", help="beyond what good flights show")
    learn.set_defaults(run=_baseline)

    for what, text in (
        ("install", "the plugin, live ports and profile into Wireshark"),
        ("check", "what is installed in Wireshark, and what is wrong with it"),
        ("uninstall", "what was installed out of Wireshark"),
    ):
        command = commands.add_parser(what, help=text)
        command.set_defaults(run=_install, what=what, purge=False)
    command.add_argument("--purge", action="store_true", help="what you changed, too")
    for name, command in commands.choices.items():
        lines = "\n".join(f"  yapp-tables {name} {example}" for example in EXAMPLES[name])
        command.epilog, command.formatter_class = f"examples:\n{lines}", argparse.RawDescriptionHelpFormatter
    return parser


def _preference(text: str) -> str:
    if ":" not in text:
        raise argparse.ArgumentTypeError(f"{text} is no preference NAME:VALUE; --out names the page or the folder")
    return text


def _positive(text: str) -> int:
    if not text.isdigit() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 on")
    return int(text)


def _share(text: str) -> Decimal:
    if not re.fullmatch(r"\d+(\.\d+)?%", text):
        raise argparse.ArgumentTypeError(f"{text} is not a share such as 10%")
    return Decimal(text.rstrip("%")) / 100


def _say(texts: Iterable[str]) -> None:
    for text in texts:
        print(f"yapp-tables: {text}", file=sys.stderr)


def _install(given: argparse.Namespace) -> int:
    return install.run(given.what, given.purge, install.own_program())


def _captures(patterns: list[str]) -> list[str]:
    """Return what is named, and what stdin names for `-`."""
    if "-" not in patterns:
        return patterns
    listed = [line for line in sys.stdin.read().splitlines() if line.strip()]
    return [name for name in patterns if name != "-"] + listed


def _config(given: argparse.Namespace) -> Config:
    tshark = Tshark(given.tshark, given.plugin, tuple(given.options), given.filter, given.profile)
    aircraft = read_fleet(given.fleet) if given.fleet else ()
    partition = getattr(given, "partition", None)
    bench = getattr(given, "bench", None)
    bench = os.path.abspath(bench) if bench else None
    return Config(str(given.out), getattr(given, "to", "parquet"), tshark, aircraft, partition=partition, bench=bench)


class _NoPandas(MetaPathFinder):
    """Arrow imports pandas where it is installed, which takes as long as a flight of half an hour, and needs none."""

    def find_spec(self, name: str, *_: object) -> None:
        """Refuse it."""
        if name == "pandas":
            raise ImportError(name)


def _convert(given: argparse.Namespace) -> int:
    # The process is this command's own. What Dask has to say of lost workers it mends itself.
    logging.disable(logging.CRITICAL)
    if given.to != "mf4":
        sys.meta_path.insert(0, _NoPandas())
    captures = _captures(given.captures)
    if given.bench and len(fleet.find(captures)) > 1:
        raise SetupError(f"{given.bench} is the log of one capture: name that one alone")
    results = fleet.convert(captures, _config(given), jobs=given.jobs, scheduler=given.scheduler)
    lacking, failed = 0, 0
    for result in results:
        lacks = left_out(result.partial, "", [*result.lacks, *result.notes])
        _say(f"{result.capture}: {text}" for text in ([result.failure] if result.failure else lacks))
        failed += bool(result.failure or result.partial)
        lacking += bool(result.lacks)
    _say(sorted({result.hint for result in results if result.hint})[:1])
    rows = sum(sum(result.messages.values()) for result in results)
    whole = count_of(len(results), "capture")
    _say([f"{whole}, {count_of(rows, 'row')} in {given.out}"])
    if failed:
        _say([f"{failed} of {whole} failed: {given.out.rstrip('/')}.yapp-tables/failures.csv"])
    if lacking:
        verb = "was" if lacking == 1 else "were"
        _say([f"{lacking} of {whole} {verb} not decoded completely: the lines above say what to set"])
    return FAILED if failed or (lacking and given.strict) else INCOMPLETE if lacking else 0


def _prune(given: argparse.Namespace) -> int:
    for result in fleet.prune(given.out, given.to):
        print(f"removed   {result.capture}")
    return 0


def _report(given: argparse.Namespace) -> int:
    write_reports = need(f"{__package__}.report", "report").write_reports
    captures = fleet.find(_captures(given.captures))
    _, pages = write_reports(captures, _config(given), given.out, given.overlay, given.rules)
    for page in pages:
        _say(f"{page['name']}: {text}" for text in page["left_out"])
    if any(page["partial"] for page in pages):
        return FAILED
    return (FAILED if given.strict else INCOMPLETE) if any(page["left_out"] for page in pages) else 0


def _case(given: argparse.Namespace) -> int:
    write_case = need(f"{__package__}.case", "report").write_case
    print(f"{given.out}: {write_case(Path(given.capture), given.number, _config(given), Path(given.out))}")
    return 0


def _graphs(given: argparse.Namespace) -> int:
    captures = fleet.find(_captures(given.captures))
    folder, names = graphs.write_graphs(captures, _config(given), Path(given.out) if given.out else None)
    _say([f"graphs of {', '.join(names)} in {folder}: choose the profile again, or start Wireshark again"])
    return 0


def _diff(given: argparse.Namespace) -> int:
    from . import diff  # its libraries take a while

    before, after = diff.captures_of(given.before), diff.captures_of(given.after)
    given.out, page = "", given.out
    found = diff.compare(before, after, _config(given), Path(given.rules) if given.rules else None)
    if given.junit:
        write_whole(Path(given.junit), diff.junit(found))
    if page:
        write_whole(Path(page), diff.page(found))
    for line in diff.json_lines(found) if given.json else diff.lines(found):
        print(line)
    code: int = found.code
    return code


def _trend(given: argparse.Namespace) -> int:
    from . import trend

    found, notes = trend.drifts(Path(given.data))
    if given.out:
        write_whole(Path(given.out), trend.page(found, notes))
    for line in trend.json_lines(found) if given.json else trend.lines(found, notes):
        print(line)
    return 0


def _baseline(given: argparse.Namespace) -> int:
    captures = fleet.find(_captures(given.captures))
    text, left = baseline.learn(captures, _config(given), given.margin)
    write_whole(Path(given.out), text)
    _say([*left, f"{count_of(len(captures), 'flight')} in {given.out}"])
    return (FAILED if given.strict else INCOMPLETE) if left else 0
