# SPDX-License-Identifier: GPL-2.0-or-later
"""A data set in a folder or a cloud: which flights it has, what is up to date, how a result gets its place at once."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import fsspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from .errors import SetupError, need
from .scratch import clean, scratch
from .tables import SCHEMA

NOTES = ".yapp-tables"
# Files of several flights begin so.
PART = "part-"
# The plan of such a file, while it is put in the place of others.
MERGE = "merge.json"
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
SUFFIXES = (".gz", ".zst", ".lz4", ".pcapng", ".pcap", ".cap", ".log", ".txt", ".yapp", ".candump")


@dataclass(frozen=True)
class MadeBy:
    """What a result depends on besides its capture. catalogue: {message: a short name of its description}."""

    plugin: str
    catalogue: dict[str, str]
    options: tuple[str, ...] = ()
    filter: str | None = None
    layout: int = SCHEMA


@dataclass(frozen=True)
class Result:
    """What is known of a converted capture.

    flight_id: of the capture's content; capture: its absolute path; files: relative to the data set;
    messages: {message: rows}; partial: why only a part could be read; lacks: sentences on what was not decoded;
    failure: why there are no files; hint: what to set so that controllers have names; notes: sentences on what it has.
    """

    flight_id: str
    capture: str
    made_by: MadeBy
    files: tuple[str, ...] = ()
    messages: dict[str, int] = field(default_factory=dict)
    partial: str | None = None
    lacks: tuple[str, ...] = ()
    failure: str | None = None
    hint: str = ""
    notes: tuple[str, ...] = ()

    def is_current(self, made_by: MadeBy) -> bool:
        """Return whether it needs no other try: made by the same, but for messages that it does not have."""
        ours, theirs = self.made_by, made_by
        known = ours.catalogue.keys()
        changed = {name for name, digest in theirs.catalogue.items() if ours.catalogue.get(name) != digest}
        # A message that is new may be in any capture; one that changed only where it was, or where something was not
        # decoded.
        same = not (changed - known) and not (changed | (known - theirs.catalogue.keys())) & self.messages.keys()
        rest = [(made.plugin, made.options, made.filter, made.layout) for made in (ours, theirs)]
        return self.failure is None and rest[0] == rest[1] and same and not (changed and self.lacks)


def flight_id(capture: Path) -> str:
    """Return the name of a capture's content: the first 16 digits of its SHA-256."""
    with capture.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def plain_name(capture: Path) -> str:
    """Return a capture's name without what tells its form: `flight` of flight.pcapng.gz."""
    plain = capture.name
    while Path(plain).suffix.lower() in SUFFIXES:
        plain = Path(plain).stem
    return plain


class DataSet:
    """The results of one kind. What is known of them lies beside the data, in `<out>.yapp-tables/<kind>`."""

    def __init__(self, out: str, to: str, run: str = "") -> None:
        """Find the place. Raises SetupError.

        out: a folder or URL, "data" or "s3://bucket/data"; to: the kind; run: a name of this run, for `clean`.
        """
        self.to, self.run = to, run
        try:
            self.fs, path = fsspec.core.url_to_fs(out)
        except (ImportError, ValueError) as error:
            raise SetupError(f"{out}: {error}") from error
        self.path: str = path.rstrip("/")
        self.is_local = isinstance(self.fs, fsspec.implementations.local.LocalFileSystem)
        if not self.is_local and "/" not in self.path:
            raise SetupError(f"{out} names no folder: {out.rstrip('/')}/data")
        self.beside = self.path + NOTES
        self.notes = f"{self.beside}/{to}"
        self.url: str = self.fs.unstrip_protocol(self.path)

    def open(self) -> None:
        """Make the folders; SetupError where they cannot be written, or hold results of an earlier version."""
        try:
            if self.fs.exists(f"{self.path}/{NOTES}"):
                raise SetupError(f"{self.path} is of yapp-tables 2.1, which had no flight_id: choose another folder")
            for folder in (self.path, f"{self.notes}/paths"):
                self.fs.makedirs(folder, exist_ok=True)
        except OSError as error:
            raise SetupError(f"{self.path} cannot be written: {error.strerror or error}") from error

    def identify(self, capture: Path) -> tuple[str, str | None]:
        """Return the flight_id of a capture, and the one that this path had before, if another.

        A capture of the same size and time of change is not read again.
        """
        state: list[int] = [capture.stat().st_size, capture.stat().st_mtime_ns]
        note = f"paths/{hashlib.sha256(str(capture).encode()).hexdigest()[:16]}"
        known = self._read(note) or {}
        if known.get("state") == state:
            return known["flight_id"], known.get("before")
        flight, before = flight_id(capture), known.get("flight_id")
        self._write(note, {"state": state, "flight_id": flight, "before": before})
        return flight, before

    def find(self, flight: str) -> Result | None:
        """Return what is known of a flight."""
        record = self._read(flight)
        return None if record is None else _result(record)

    def results(self) -> Iterator[Result]:
        """Return what is known of all flights, all notes asked for at once."""
        if paths := self.fs.glob(f"{self.notes}/*.json"):
            notes = self.fs.cat(paths, on_error="omit")
            yield from (_result(json.loads(notes[path])) for path in sorted(notes))

    def has_files(self, result: Result) -> bool:
        """Return whether the files of a result are there."""
        return all(self.fs.exists(f"{self.path}/{file}") for file in result.files)

    @contextmanager
    def aside(self) -> Iterator[Path]:
        """A local folder to write to, of this task alone; on the file system of the data where that is local."""
        with scratch(self.beside if self.is_local else None, self.run) as folder:
            yield folder

    def place(self, folder: Path, result: Result) -> None:
        """Move all files in folder to their place, remove what an older result left, and note the result last."""
        before = self.find(result.flight_id)
        for file in result.files:
            self.move(folder / file, f"{self.path}/{file}")
        self._remove(set(before.files if before else ()) - set(result.files), result.flight_id)
        # A result that was cut off half-way is not known, and is made again.
        self.note(result)

    def note(self, result: Result) -> None:
        """Remember a result."""
        self._write(result.flight_id, asdict(result))

    def forget(self, result: Result) -> None:
        """Remove a flight."""
        if self.to == "delta":
            need(f"{__package__}.delta", "delta").delete(self.url, result.flight_id, result.messages)
        self._remove(result.files, result.flight_id)
        self.fs.rm(f"{self.notes}/{result.flight_id}.json")

    def extend(self) -> None:
        """Give the files of each message, Parquet or CSV, the columns of all of them; what is new there is null."""
        found: dict[str, list[str]] = {}
        made: dict[str, set[str]] = {}
        for result in self.results():
            for file in result.files:
                message = file.partition("/")[0].removeprefix("message=")
                found.setdefault(message, []).append(file)
                made.setdefault(message, set()).add(result.made_by.catalogue.get(message, ""))
        for message, files in found.items():
            if len(made[message]) > 1:
                with self.aside() as folder:
                    paths = {file: self.local(file, folder / f"{number}") for number, file in enumerate(files)}
                    extended = _extended_parquet if self.to == "parquet" else _extended_csv
                    for file in extended(paths, folder / "new"):
                        self.move(folder / "new", f"{self.path}/{file}")

    def local(self, file: str, copy: Path | None = None) -> str:
        """Return the path of a file on this machine, of which copy is a copy where it is in a cloud."""
        if self.is_local or copy is None:
            return f"{self.path}/{file}"
        self.fs.get_file(f"{self.path}/{file}", str(copy))
        return str(copy)

    def move(self, file: Path, target: str) -> None:
        """Give a file its place at once."""
        if self.is_local:
            Path(target).parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
        else:
            self.fs.put_file(str(file), target)

    def _remove(self, files: Iterable[str], flight: str) -> None:
        """Remove the files of a flight; out of those of several flights its rows."""
        for path in (f"{self.path}/{file}" for file in files):
            if path.rpartition("/")[2].startswith(PART):
                self._remove_rows(path, flight)
            elif self.fs.exists(path):
                self.fs.rm(path)

    def _remove_rows(self, path: str, flight: str) -> None:
        with self.lock(), self.aside() as folder:
            if not self.fs.exists(path):
                return
            left = 0
            with (
                pq.ParquetFile(path) as old,
                pq.ParquetWriter(folder / "new", old.schema_arrow, compression="zstd") as new,
            ):
                for batch in old.iter_batches(100_000):
                    kept = pc.not_equal(batch.column("flight_id").cast(pa.string()), flight)
                    rows = pa.Table.from_batches([batch.filter(kept)])
                    new.write_table(rows.unify_dictionaries())
                    left += len(rows)
            if left:
                self.move(folder / "new", path)
            else:
                self.fs.rm(path)

    def replace_files(self, new: Path, name: str, group: Sequence[str], owners: Sequence[str]) -> None:
        """Put one file in the place of several, of these flights. If this is killed, `clean` does the rest."""
        plan = {"name": name, "group": list(group), "owners": list(owners)}
        self.write(MERGE, json.dumps(plan))
        # A reader sees the rows twice only from here until the old files are gone.
        self.move(new, f"{self.path}/{name}")
        self._finish_merge(plan)

    def _finish_merge(self, plan: dict[str, Any]) -> None:
        if self.fs.exists(f"{self.path}/{plan['name']}"):
            for file in plan["group"]:
                Path(self.path, file).unlink(missing_ok=True)
            for flight in plan["owners"]:
                if result := self.find(flight):
                    kept = [file for file in result.files if file not in (*plan["group"], plan["name"])]
                    self.note(replace(result, files=(*kept, plan["name"])))
        Path(self.beside, MERGE).unlink()

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the files of several flights, which one writer at a time may change. They are local."""
        with Path(self.beside, "lock").open("w") as file:
            if fcntl:
                fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def write(self, path: str, text: str) -> None:
        """Write a small file whole or not at all. path: in the folder beside the data."""
        with self.aside() as folder:
            (folder / "file").write_text(text, encoding="utf-8", newline="")
            self.move(folder / "file", f"{self.beside}/{path}")

    def _write(self, name: str, record: dict[str, Any]) -> None:
        self.write(f"{self.notes.rpartition('/')[2]}/{name}.json", json.dumps(record, indent=1))

    def _read(self, name: str) -> dict[str, Any] | None:
        try:
            record: dict[str, Any] = json.loads(self.fs.cat_file(f"{self.notes}/{name}.json"))
            return record
        except (OSError, ValueError):
            return None

    def clean(self) -> None:
        """Remove what this run, or one that was killed, left aside."""
        clean(self.beside if self.is_local else None, self.run)
        merge = Path(self.beside, MERGE)
        if self.is_local and merge.is_file():
            with self.lock():
                if merge.is_file():
                    self._finish_merge(json.loads(merge.read_text(encoding="utf-8")))


def _result(record: dict[str, Any]) -> Result:
    made_by = record.pop("made_by")
    made_by["options"] = tuple(made_by["options"])
    lists = {name: tuple(record.get(name, ())) for name in ("files", "lacks", "notes")}
    return Result(**{**record, **lists, "made_by": MadeBy(**made_by)})


def _extended_parquet(paths: dict[str, str], new: Path) -> Iterator[str]:
    """Write each file that lacks columns of the others once more, to new, and yield which one that is."""
    schemas = {file: pq.read_schema(path) for file, path in paths.items()}
    whole = pa.unify_schemas(sorted(schemas.values(), key=len, reverse=True), promote_options="permissive")
    for file, schema in schemas.items():
        if schema.names != whole.names or schema.types != whole.types:
            data = pq.ParquetFile(paths[file]).read()
            columns = [
                data[each.name].cast(each.type) if each.name in schema.names else pa.nulls(len(data), each.type)
                for each in whole
            ]
            data = pa.table(columns, schema=whole.with_metadata(schema.metadata))
            pq.write_table(data, new, compression="zstd")
            yield file


def _extended_csv(paths: dict[str, str], new: Path) -> Iterator[str]:
    """Do as _extended_parquet does."""
    heads = {}
    for file, path in paths.items():
        with open(path, encoding="utf-8", newline="") as old:
            heads[file] = next(csv.reader(old))
    whole = dict.fromkeys(name for head in sorted(heads.values(), key=len, reverse=True) for name in head)
    for file, head in heads.items():
        if head != list(whole):
            with (
                open(paths[file], encoding="utf-8", newline="") as old,
                new.open("w", encoding="utf-8", newline="") as out,
            ):
                writer = csv.DictWriter(out, whole, lineterminator="\n")
                writer.writeheader()
                writer.writerows(csv.DictReader(old))
            yield file
