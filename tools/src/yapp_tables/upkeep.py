# SPDX-License-Identifier: GPL-2.0-or-later
"""Upkeep of a data set: few large files of many small ones, old files removed, data of an older version converted."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from .clock import YEAR_2000, Stretches, clock_of
from .dataset import PART, DataSet, Result
from .difference import difference
from .errors import SetupError, need
from .records import FLIGHTS, TABLES, incidents
from .tables import DURATION, HEAD, KIND, SCHEMA, Message, digests, messages
from .tshark import Tshark
from .writers import ROW_GROUP


def compact(out: str, to: str, flights: int = 100, megabytes: int = 256) -> int:
    """Make files of at most so many flights or megabytes. Returns how many files there are less. Raises SetupError."""
    dataset = DataSet(out, to)
    if to == "delta":
        names = {name for result in dataset.results() for name in result.messages}
        before = _delta_files(dataset, names)
        need(f"{__package__}.delta", "delta").compact(dataset.url, names)
        return before - _delta_files(dataset, names)
    if to != "parquet" or not dataset.is_local:
        raise SetupError(f"{out}: compact is for Parquet in a folder and for Delta; --to delta is for object stores")
    dataset.clean()
    less = 0
    with dataset.lock():
        results = {result.flight_id: result for result in dataset.results() if result.files}
        by_folder: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        for result in results.values():
            for file in result.files:
                by_folder[file.rpartition("/")[0]][file].append(result.flight_id)
        for folder, files in sorted(by_folder.items()):
            sizes = {file: Path(dataset.path, file).stat().st_size for file in files}
            for group in _groups(files, sizes, flights, megabytes << 20):
                _merge(dataset, folder, group, files, results)
                less += len(group) - 1
    return less


def _groups(files: dict[str, list[str]], sizes: dict[str, int], flights: int, most: int) -> Iterator[list[str]]:
    """Yield files to merge: two or more, in the order of their names, that keep both limits."""
    group: list[str] = []
    count = size = 0
    for file in sorted(files, key=lambda file: (file.rpartition("/")[2].startswith(PART), file)):
        if group and (count + len(files[file]) > flights or size + sizes[file] > most):
            if len(group) > 1:
                yield group
            group, count, size = [], 0, 0
        group.append(file)
        count, size = count + len(files[file]), size + sizes[file]
    if len(group) > 1:
        yield group


def _merge(
    dataset: DataSet, folder: str, group: list[str], files: dict[str, list[str]], results: dict[str, Result]
) -> None:
    """Write one file in the place of several."""
    paths = [f"{dataset.path}/{file}" for file in group]
    whole = pa.unify_schemas([pq.read_schema(path) for path in paths], promote_options="permissive")
    name = f"{folder}/{PART}{hashlib.sha256(' '.join(group).encode()).hexdigest()[:16]}.parquet"
    with dataset.aside() as aside:
        new = aside / "part"
        with pq.ParquetWriter(new, whole, compression="zstd") as writer:
            for path in paths:
                for batch in pq.ParquetFile(path).iter_batches(ROW_GROUP):
                    rows = pa.Table.from_batches([batch])
                    missing = [field for field in whole if field.name not in rows.schema.names]
                    for field in missing:
                        rows = rows.append_column(field, pa.nulls(len(rows), field.type))
                    writer.write_table(rows.select(whole.names).cast(whole).unify_dictionaries())
        owners = [flight for file in group for flight in files[file]]
        dataset.replace_files(new, name, group, owners)
    for flight in owners:
        kept = tuple(file for file in results[flight].files if file not in group)
        results[flight] = replace(results[flight], files=(*kept, name))


def vacuum(out: str, hours: int) -> int:
    """Remove the files of Delta tables that no version of the latest hours needs. Returns how many."""
    dataset = DataSet(out, "delta")
    names = {name for result in dataset.results() for name in result.messages}
    if not names:
        raise SetupError(f"{out} has no Delta tables: vacuum is for what convert --to delta wrote")
    delta: Any = need(f"{__package__}.delta", "delta")
    return sum(len(delta.vacuum(dataset.url, name, hours)) for name in names)


def _delta_files(dataset: DataSet, names: Iterable[str]) -> int:
    delta: Any = need(f"{__package__}.delta", "delta")
    return sum(len(delta.files(dataset.url, name)) for name in names)


def upgrade(out: str, to: str, tshark: Tshark) -> list[Result]:
    """Convert the flights of an older version of the data set, without their captures. Returns them.

    Raises SetupError for another kind than Parquet and Delta.
    """
    if to not in ("parquet", "delta"):
        raise SetupError(
            f"{out}: upgrade is for Parquet and Delta; convert the captures again for {to}, into another folder"
        )
    dataset = DataSet(out, to)
    old = [result for result in dataset.results() if result.messages and result.made_by.layout < SCHEMA]
    if not old:
        return []
    fields = tshark.fields()[0]
    known, catalogue = messages(fields), digests(fields)
    if to == "delta":
        _upgrade_delta(dataset, known)
    for result in old:
        if to == "parquet":
            _upgrade_parquet(dataset, result, known)
        same = {name: catalogue.get(name, digest) for name, digest in result.made_by.catalogue.items()}
        dataset.note(replace(result, made_by=replace(result.made_by, layout=SCHEMA, catalogue=same)))
    return old


def _upgrade_parquet(dataset: DataSet, result: Result, known: dict[str, Message]) -> None:
    """Write the files of a flight anew, in their place."""
    about = _About()
    files = {file.partition("/")[0].removeprefix("message="): file for file in result.files}
    for name in sorted(files, key=_flights_last):
        rows = pq.ParquetFile(dataset.local(files[name])).read()
        with dataset.aside() as aside:
            pq.write_table(about.renew(rows, name, known.get(name)), aside / "new", compression="zstd")
            dataset.move(aside / "new", f"{dataset.path}/{files[name]}")


def _upgrade_delta(dataset: DataSet, known: dict[str, Message]) -> None:
    """Write each table anew, flight by flight in one transaction: a run that was killed is done again."""
    delta: Any = need(f"{__package__}.delta", "delta")
    flights: dict[str, _About] = defaultdict(_About)
    for name in sorted({name for result in dataset.results() for name in result.messages}, key=_flights_last):

        def renewed(flight: str, rows: pa.Table, name: str = name) -> pa.Table:
            return flights[flight].renew(rows, name, known.get(name))

        delta.rewrite(dataset.url, name, sorted(one.flight_id for one in dataset.results()), renewed)


def _flights_last(name: str) -> tuple[bool, str]:
    return name == "flights", name


class _About:
    """What the other tables of a flight say for its row in `flights`."""

    def __init__(self) -> None:
        self.clocks: list[Stretches] = []
        self.faults = 0

    def renew(self, rows: pa.Table, name: str, message: Message | None) -> pa.Table:
        """Return the rows of a table in this version; `flights` comes last."""
        rows = _new_table(rows, name, message)
        if name not in TABLES and len(rows):
            self.clocks.append(Stretches())
            in_order = rows.select(["time", "frame"]).sort_by("frame")
            self.clocks[-1].add(*(in_order[each].combine_chunks() for each in ("time", "frame")))
        if name == "events":
            self.faults = incidents(_named(rows))
        return self._flight(rows) if name == "flights" and len(rows) else rows

    def _flight(self, rows: pa.Table) -> pa.Table:
        clock = clock_of(self.clocks)
        start = clock.start if clock.start and clock.start >= YEAR_2000 else None
        new = {"start": start, "length": clock.length / 1e9, "clock_resets": clock.resets}
        new |= {"is_absolute": start is not None, "faults": self.faults}
        for name, value in new.items():
            at = rows.schema.get_field_index(name)
            rows = rows.set_column(at, rows.schema.field(at), pa.array([value], FLIGHTS[name].type))
        return rows


def _named(events: pa.Table) -> pa.Table:
    return events.rename_columns(["message" if name == "message_name" else name for name in events.schema.names])


def _new_table(rows: pa.Table, name: str, message: Message | None) -> pa.Table:
    """Return rows with the types and columns of this version: reserved values null, durations, dictionaries."""
    columns = dict(zip(rows.schema.names, rows.columns, strict=True))
    fields = {field.name: field for field in rows.schema}
    wanted: dict[str, pa.DataType] = dict(HEAD) if name not in TABLES else {"flight_id": KIND, "source_file": KIND}
    own = TABLES.get(name, message.columns if message else {})
    for column in own.values():
        each = "message_name" if column.name == "message" and name in TABLES else column.name
        wanted[each] = column.type
        fields.setdefault(each, column.arrow())
    order = dict.fromkeys([*wanted, *columns])
    if "controller" in wanted and "source" in columns:
        columns.setdefault("controller", columns["source"])
    for column in own.values():
        if column.difference and set(column.difference) <= columns.keys():
            columns.setdefault(column.name, difference(*(_finite(columns[each]) for each in column.difference)))
    done = {each: _new_column(columns.get(each), wanted.get(each), len(rows)) for each in order}
    schema = pa.schema(
        [fields.get(each, pa.field(each, cells.type)).with_type(cells.type) for each, cells in done.items()],
        metadata=(rows.schema.metadata or {}) | {b"schema": str(SCHEMA).encode()},
    )
    return pa.table(list(done.values()), schema=schema)


def _new_column(cells: pa.ChunkedArray | None, type_: pa.DataType | None, count: int) -> Any:
    if cells is None:
        return pa.nulls(count, type_)
    if pa.types.is_floating(cells.type):
        cells = _finite(cells)
        if type_ == DURATION:
            return pc.round(pc.multiply(cells, 1e9)).cast(pa.int64()).cast(DURATION)
    if type_ == KIND:
        return cells if cells.type == KIND else cells.cast(pa.string()).dictionary_encode()
    return cells if type_ is None else cells.cast(type_)


def _finite(cells: pa.ChunkedArray) -> pa.ChunkedArray:
    return pc.if_else(pc.is_finite(cells), cells, None)
