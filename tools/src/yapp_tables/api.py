# SPDX-License-Identifier: GPL-2.0-or-later
"""What a program calls: read, convert, report. `how` are the keywords of Tshark."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from .convert import Config, Kind, StrPath, convert_all
from .dataset import Result
from .errors import need
from .flight import Flight, read_flight
from .tshark import Tshark


def read(
    capture: StrPath, *, messages: Sequence[str] | None = None, columns: Sequence[str] | None = None, **how: Any
) -> Flight:
    """Read a capture with tshark and the plugin.

    messages: names of messages, ["motor"]; columns: names of columns besides the time, ["rpm_measured"]; None for all.
    What is not wanted is not read.

    What is left out is a warning: the rest of a damaged capture, messages that were not decoded.
    Returns a Flight. Raises YappError; MessageError, with the words that exist, for an unknown message or column.
    """
    flight = read_flight(Path(capture), Tshark(**how), messages, columns)
    for text in flight.left_out:
        warnings.warn(f"{capture}: {text}", stacklevel=2)
    return flight


def convert(
    captures: StrPath | Iterable[StrPath],
    out: StrPath,
    *,
    to: Kind = "parquet",
    jobs: int | None = None,
    scheduler: str | None = None,
    **how: Any,
) -> list[Result]:
    """Convert captures to a data set; what is up to date is not converted again.

    captures: paths or patterns; out: a folder or a URL of fsspec, "s3://bucket/data"; to: "parquet", "csv", "delta",
    "mf4" or "mcap"; jobs: captures at a time, None for a core each; scheduler: of a Dask cluster, "tcp://HOST:PORT".
    Returns a Result for each capture. Raises SetupError.
    """
    return convert_all(captures, Config(str(out), to, Tshark(**how)), jobs=jobs, scheduler=scheduler)


def report(capture: StrPath, out: StrPath | None = None, *, rules: StrPath | None = None, **how: Any) -> Path:
    """Write the page of a capture.

    out: the page, None for one named as the capture; rules: a file of rules, whose ranges are limits in the pictures.
    Returns the page. Raises YappError.
    """
    page = Path(capture).with_suffix(".html") if out is None else Path(out)
    need(f"{__package__}.report", "report").report(Path(capture), Tshark(**how), page, rules and Path(rules))
    return page
