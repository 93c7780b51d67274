# SPDX-License-Identifier: GPL-2.0-or-later
"""One capture to its result: tshark writes aside, a writer makes files of that, they are moved to their place."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from .config import Config, StrPath
from .dataset import DataSet, MadeBy, Result, plain_name
from .errors import CaptureError, SetupError, YappError, need
from .records import YEAR_2000, all_tables, columns_of, name_hint, table
from .sources import begin
from .tables import Origin, Table, digests, nothing_in, present
from .tshark import Export, Tshark, check_file, left_out
from .writers import Target, Writer

# How readers of such folders call an unknown value.
NO_PARTITION = "__HIVE_DEFAULT_PARTITION__"
# The module and the function that write a kind, and the extra that it needs: imported only when it is asked for.
KINDS = {
    "parquet": ("writers", "write_parquet", ""),
    "csv": ("writers", "write_csv", ""),
    "delta": ("delta", "write_delta", "delta"),
    "mf4": ("mf4", "write_mf4", "mdf"),
    "mcap": ("mcap_file", "write_mcap", "mcap"),
}


def writer(to: str) -> Writer:
    """Return what writes this kind; SetupError where its library is missing."""
    if to not in KINDS:
        raise SetupError(f"no kind {to!r}; known kinds: {', '.join(KINDS)}")
    module, function, extra = KINDS[to]
    found: Writer = getattr(need(f"{__package__}.{module}", extra), function)
    return found


def made_by(tshark: Tshark, fields: dict[str, object]) -> MadeBy:
    """Return what results of this tshark depend on, from its fields.json."""
    options = (*tshark.options, *((f"-C {tshark.profile}",) if tshark.profile else ()))
    return MadeBy(str(fields["plugin"]), digests(fields), options, tshark.filter)


def look_up(capture: Path, dataset: DataSet, made: MadeBy) -> tuple[str, str | None, Result | None]:
    """Return the flight_id of a capture, that of what this path had before, and its result if that is up to date."""
    check_file(capture)
    flight, before = dataset.identify(capture)
    known = dataset.find(flight)
    if known is None or not known.is_current(made) or not dataset.has_files(known):
        return flight, before, None
    if known.capture != str(capture) and not os.path.exists(known.capture):  # it was moved
        known = replace(known, capture=str(capture))
        dataset.note(known)
    return flight, before, known


def convert_one(capture: StrPath, config: Config, made: MadeBy | None = None, tries: int = 3) -> Result:
    """Convert one capture: a task for Dask, Prefect, Dagster or a loop.

    It may run twice at once, and be killed at any point: the data set then has the flight once, or not yet.

    made: made_by() of the machine that gives the order; this one must give the same; tries: how often a tshark that
    crashes is started.

    Returns the Result, whose `failure` says why there is no data. Raises SetupError where no other capture would do
    better on this machine, and YappError where the data set cannot be written.
    """
    capture = Path(os.path.abspath(capture))
    tshark, aircraft = config.of(capture)
    made = made or made_by(tshark, tshark.fields()[0])
    dataset = DataSet(config.out, config.to, config.run)
    dataset.open()
    flight = ""
    try:
        flight, before, known = look_up(capture, dataset, made)
        if known and not config.bench:
            return known
        result = _convert(capture, config, dataset, Origin(flight, capture, aircraft, tshark), made)
        former = dataset.find(before) if before and before != flight else None
        if former and former.capture == str(capture):  # the file has another content now
            dataset.forget(former)
        return result
    except SetupError:
        raise
    except OSError as error:
        raise YappError(f"{config.out}: {error}") from error
    except YappError as error:
        if tries > 1 and not isinstance(error, CaptureError):
            return convert_one(capture, config, made, tries - 1)
        failed = Result(flight, str(capture), made, failure=str(error).removeprefix(f"{capture}: "))
        if flight:
            dataset.place(capture.parent, failed)
        return failed


def _convert(capture: Path, config: Config, dataset: DataSet, origin: Origin, made: MadeBy) -> Result:
    with dataset.aside() as aside:
        export = origin.tshark.export(capture, aside / "export")
        _check(capture, origin.tshark, export, made)
        tables = all_tables(export, origin, Path(config.bench) if config.bench else None)
        name = f"{plain_name(capture)}-{origin.flight_id[:8]}{'.partial' if export.partial else ''}"
        folder = aside / "result"
        folder.mkdir()
        before = dataset.find(origin.flight_id)
        writer(config.to)(
            tables, Target(folder, name, dataset.url, origin.flight_id, _partition(config, origin, tables))
        )
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        counts = {table.name: table.count for table in tables}
        lacks = tuple(left_out(None, export.undecoded, export.complaints))
        hint = name_hint(table(export.records["summary"], columns_of(export.fields, "summary")))
        result = Result(
            origin.flight_id, str(capture), made, tuple(files), counts, export.partial, lacks, hint=hint,
            notes=(*export.notes, *export.said),
        )  # fmt: skip
        dataset.place(folder, result)
        if before and config.to == "delta" and (gone := before.messages.keys() - counts.keys()):
            need(f"{__package__}.delta", "delta").delete(dataset.url, origin.flight_id, gone)
        return result


def _partition(config: Config, origin: Origin, tables: Sequence[Table]) -> str:
    """Return the folder of a flight below each table: its day in UTC, or its aircraft."""
    if config.partition is None:
        return ""
    value = origin.aircraft
    if config.partition == "day":
        start = begin(tables)
        value = str(datetime.fromtimestamp(start // 10**9, UTC).date()) if start >= YEAR_2000 else None
    return f"{config.partition}={quote(value, safe='') if value else NO_PARTITION}"


def _check(capture: Path, tshark: Tshark, export: Export, made: MadeBy) -> None:
    here = made_by(tshark, export.fields)
    if here != made:
        raise SetupError(f"the machine that works on it has another plugin or catalogue: {here}, not {made}")
    if not present(export):
        raise CaptureError(nothing_in(capture, export, tshark.filter))
