# SPDX-License-Identifier: GPL-2.0-or-later
"""What a program calls: read, read_many, convert, report."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar, Unpack

from tqdm import tqdm

from . import fleet
from .config import Config, How, Kind, Partition, StrPath, read_fleet, tshark_of
from .convert import made_by
from .dataset import Result, flight_id
from .errors import YappError, need
from .flight import Flight
from .scratch import scratch
from .tshark import Tshark, check_file

HOW = """

    How it is decoded:

    options: preferences for tshark, ["yapp.motor_ids:0x210,0x211"]; sources: names of controllers, one for all IDs of
    a controller, {"can0/0x210+0x200": "left"}; filter: a display filter, only these messages are taken; profile: one
    of Wireshark; plugin: yapp.lua where it is not installed; tshark: the program where it is not in PATH. One text is
    a list of one: options="yapp.motor_ids:0x210".
    """
Function = TypeVar("Function")


def _with_how(function: Function) -> Function:
    """Add what all functions have in common to a docstring: help() shows it."""
    function.__doc__ = (function.__doc__ or "").rstrip() + HOW
    return function


@_with_how
def read(
    capture: StrPath, *, messages: Sequence[str] | None = None, columns: Sequence[str] | None = None, **how: Unpack[How]
) -> Flight:
    """Read a capture with tshark and the plugin.

    messages: names of messages, ["motor"]; columns: names of columns besides the time, ["rpm_measured"]; None for all.
    What is not wanted is not read.

    What is left out is a warning: the rest of a damaged capture, messages that were not decoded.
    Returns a Flight. Raises YappError; MessageError, with the words that exist, for an unknown message or column.
    """
    flight = read_flight(Path(capture), tshark_of(**how), messages, columns)
    for text in flight.left_out:
        warnings.warn(f"{capture}: {text}", stacklevel=2)
    return flight


def read_flight(
    capture: Path,
    tshark: Tshark,
    messages: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    cache: Path | None = None,
    has_begin: bool = False,
) -> Flight:
    """Read as `read` does, without its warnings.

    cache: a folder that keeps, or has, what tshark wrote; has_begin: whether the first packet's time is wanted, for
    which tshark runs once more.
    """
    with scratch(cache and cache.parent) as folder:
        export = tshark.export(capture, cache if cache and cache.is_dir() else Path(folder, "export"))
        flight = Flight(capture, export, messages, columns, tshark.begin(capture) if has_begin else None)
        if cache and not cache.is_dir():
            Path(folder, "export").rename(cache)
        return flight


@_with_how
def read_many(
    captures: StrPath | Iterable[StrPath],
    *,
    cache: StrPath | None = None,
    messages: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    **how: Unpack[How],
) -> Iterator[Flight]:
    """Read captures one after the other, each when it is asked for, with a progress bar on a terminal.

    captures: paths or patterns; cache: a folder that keeps what tshark wrote (as much as a capture has bytes), so that
    the next time no tshark runs. A capture that fails is a warning, and left out. Yields a Flight of each.
    """
    tshark = tshark_of(**how)
    made = repr((tshark, made_by(tshark, tshark.fields()[0]))) if cache else ""
    if cache:
        os.makedirs(cache, exist_ok=True)
    for capture in tqdm(fleet.find(captures), unit="flight", disable=None):
        try:
            check_file(capture)
            key = hashlib.sha256(f"{flight_id(capture)} {made}".encode()).hexdigest()[:24]
            flight = read_flight(capture, tshark, messages, columns, Path(cache, key).absolute() if cache else None)
        except YappError as error:
            warnings.warn(str(error), stacklevel=2)
            continue
        for text in flight.left_out:
            warnings.warn(f"{capture}: {text}", stacklevel=2)
        yield flight


@_with_how
def convert(
    captures: StrPath | Iterable[StrPath],
    out: StrPath,
    *,
    to: Kind = "parquet",
    fleet_file: StrPath | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    partition: Partition | None = None,
    **how: Unpack[How],
) -> list[Result]:
    """Convert captures to a data set; what is up to date is not converted again.

    captures: paths or patterns; out: a folder or a URL of fsspec, "s3://bucket/data"; to: "parquet", "csv", "delta",
    "mf4" or "mcap"; fleet_file: fleet.toml, with the settings of each aircraft; jobs: captures at a time, None for a
    core each; scheduler: of a Dask cluster, "tcp://HOST:PORT"; partition: "day" or "vehicle" (the aircraft of the
    fleet file), folders below each table of Parquet and CSV. Returns a Result for each capture. Raises SetupError.
    """
    aircraft = read_fleet(fleet_file) if fleet_file else ()
    config = Config(str(out), to, tshark_of(**how), aircraft, partition=partition)
    return fleet.convert(captures, config, jobs=jobs, scheduler=scheduler)


@_with_how
def report(
    captures: StrPath | Iterable[StrPath],
    out: StrPath | None = None,
    *,
    overlay: bool = False,
    rules: StrPath | None = None,
    **how: Unpack[How],
) -> Path:
    """Write the page of a capture, or a folder of pages with an index.html.

    out: the page or the folder, None for one named as the capture; overlay: lay several flights over each other, on one
    page; rules: a file of rules, whose ranges are limits in the pictures. Returns the page. Raises YappError.
    """
    write = need(f"{__package__}.report", "report")
    config = Config("", tshark=tshark_of(**how))
    page: Path = write.write_reports(fleet.find(captures), config, out, overlay, rules)[0]
    return page
