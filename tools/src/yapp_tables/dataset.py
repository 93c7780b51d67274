# SPDX-License-Identifier: GPL-2.0-or-later
"""Captures to a data set, in a folder or a cloud, on this machine's cores or a Dask cluster.

Of each capture, tshark writes aside, a writer makes files of that, and they are moved to their place. The data set
knows its flights and what they were made by; each result gets its place at once.
"""

import glob
import json
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

from pyarrow import fs

from .errors import SetupError, YappError, need, progress
from .flight import Flight, StrPath, flight_id
from .scratch import scratch
from .tables import SCHEMA, catalogue_version
from .tshark import Record, Tshark, check_file
from .writers import Writer

NOTES = ".yapp-tables"
BUSY: dict[str, Lock] = defaultdict(Lock)  # by flight: of two copies of a capture, one is converted
# What tells the form of a capture: `flight` is the name of flight.pcapng.gz.
SUFFIXES = re.compile(r"(\.(gz|zst|lz4|pcapng|pcap|cap|log|txt|yapp|candump))+$", re.IGNORECASE)
# The module and the function that write a kind, and the extra that it needs: imported only when it is asked for.
KINDS = {
    "parquet": ("writers", "write_parquet", ""),
    "csv": ("writers", "write_csv", ""),
    "delta": ("delta", "write_delta", "delta"),
    "mf4": ("mf4", "write_mf4", "mdf"),
    "mcap": ("mcap_file", "write_mcap", "mcap"),
}


@dataclass(frozen=True)
class Result:
    """What is known of a converted capture.

    flight_id: of the capture's content; capture: its absolute path; made_by: plugin, catalogue and options;
    files: relative to the data set; messages: {message: rows}; partial: why only a part could be read;
    lacks: sentences on what was not decoded; failure: why there are no files; notes: sentences on what it has.
    """

    flight_id: str
    capture: str
    made_by: str
    files: Sequence[str] = ()
    messages: dict[str, int] = field(default_factory=dict)
    partial: str | None = None
    lacks: Sequence[str] = ()
    failure: str | None = None
    notes: Sequence[str] = ()


class DataSet:
    """The results of one kind. What is known of them lies beside the data, in `<out>.yapp-tables/<kind>-<version>`."""

    def __init__(self, out: str, to: str) -> None:
        """Find the place: a folder or URL, "data" or "s3://bucket/data", and the kind. Raises SetupError."""
        self.to = to
        scheme, _, place = out.rstrip("/").partition("://")
        if place and scheme != "file" and "/" not in place:
            raise SetupError(f"{out} names no folder: {scheme}://{place}/data")
        try:
            self.fs, path = fs.FileSystem.from_uri(out if "://" in out else os.path.abspath(out))
        except (OSError, ValueError) as error:
            raise SetupError(f"{out}: {error}") from error
        self.path: str = path.rstrip("/")
        self.is_local = isinstance(self.fs, fs.LocalFileSystem)
        self.beside = self.path + NOTES
        self.notes = f"{self.beside}/{to}-{SCHEMA}"
        self.url = self.path if self.is_local else out.rstrip("/")

    def open(self) -> None:
        """Make the folder of notes; SetupError where it cannot be written, or has results of another version."""
        try:
            if self.fs.get_file_info(self.path).is_file:
                raise FileExistsError("it is a file")
            for found in self.fs.get_file_info(fs.FileSelector(self.beside, allow_not_found=True)):
                if found.base_name.startswith(self.to) and not self.notes.endswith(f"/{found.base_name}"):
                    again = f"yapp-tables convert CAPTURES --to {self.to} --out {self.path}-{SCHEMA}"
                    raise SetupError(f"{self.path} has not version {SCHEMA} of the tables; make it anew: {again}")
            if self.is_local:
                Path(self.notes).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SetupError(f"{self.path} cannot be written: {error.strerror or error}") from error

    def find(self, flight: str) -> Result | None:
        """Return what is known of a flight."""
        try:
            return Result(**json.loads(self.fs.open_input_stream(f"{self.notes}/{flight}.json").read()))
        except (OSError, ValueError):
            return None

    def results(self) -> Iterator[Result]:
        """Return what is known of all flights, several notes asked for at once."""
        notes = self.fs.get_file_info(fs.FileSelector(self.notes, allow_not_found=True))
        with ThreadPoolExecutor() as pool:
            yield from filter(None, pool.map(self.find, [note.base_name.removesuffix(".json") for note in notes]))

    def has(self, files: Iterable[str]) -> bool:
        """Return whether all these files are there."""
        return all(info.is_file for info in self.fs.get_file_info([f"{self.path}/{file}" for file in files]))

    def aside(self) -> AbstractContextManager[Path]:
        """A local folder to write to, of this task alone; on the file system of the data where that is local."""
        return scratch(self.beside if self.is_local else None)

    def place(self, folder: Path, result: Result) -> None:
        """Move all files in folder to their place, remove what an older result left, and note the result last."""
        before = self.find(result.flight_id) or result
        for file in result.files:
            self._move(folder / file, f"{self.path}/{file}")
        self._remove(result, set(before.files) - set(result.files), before.messages.keys() - result.messages.keys())
        # A result that was cut off half-way is not known, and is made again.
        self.note(result)

    def note(self, result: Result) -> None:
        """Remember a result, at once: whoever reads it meanwhile has the old one or the new one."""
        with self.aside() as folder:
            note = folder / "note.json"
            note.write_text(json.dumps(asdict(result), indent=1), encoding="utf-8")
            self._move(note, f"{self.notes}/{result.flight_id}.json")

    def forget(self, result: Result) -> None:
        """Remove a flight."""
        self._remove(result, result.files, result.messages)
        self.fs.delete_file(f"{self.notes}/{result.flight_id}.json")

    def _move(self, file: Path, target: str) -> None:
        """Give a file its place at once."""
        if self.is_local:
            Path(target).parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
        else:
            fs.copy_files(str(file), target, fs.LocalFileSystem(), self.fs)

    def _remove(self, result: Result, files: Iterable[str], messages: Iterable[str]) -> None:
        """Remove files, or of Delta's tables of these messages the rows of the flight."""
        for file in files:
            if self.has([file]):
                self.fs.delete_file(f"{self.path}/{file}")
        if self.to == "delta":
            need(f"{__package__}.delta", "delta").delete(self.url, result.flight_id, messages)


def find(patterns: StrPath | Iterable[StrPath]) -> list[Path]:
    """Return the files that are meant, absolute, in order, each once; of a folder those in it. Raises SetupError."""
    found: dict[Path, None] = {}
    for given in [patterns] if isinstance(patterns, str | os.PathLike) else patterns:
        pattern = os.path.join(glob.escape(os.fspath(given)), "*") if os.path.isdir(given) else os.fspath(given)
        names = [pattern]
        if not os.path.exists(pattern) and glob.has_magic(pattern):
            names = sorted(filter(os.path.isfile, glob.glob(pattern, recursive=True)))
            if not names:
                raise SetupError(f"no file matches {pattern}")
        found |= dict.fromkeys(Path(os.path.abspath(name)) for name in names)
    if not found:
        raise SetupError("no captures: the list is empty")
    return list(found)


def convert(
    captures: StrPath | Iterable[StrPath],
    out: StrPath,
    *,
    to: str = "parquet",
    jobs: int | None = None,
    scheduler: str | None = None,
    bench: StrPath | None = None,
    **how: Any,
) -> list[Result]:
    """Convert captures to a data set; what is up to date is not converted again. One that fails holds nobody up.

    captures: paths or patterns; out: a folder or a URL, "s3://bucket/data"; to: "parquet", "csv", "delta",
    "mf4" or "mcap"; jobs: captures at a time, None for a core each; scheduler: of a Dask cluster, "tcp://HOST:PORT";
    bench: the log of a thrust stand, for the one capture that it is of.
    Returns a Result for each. Raises SetupError where nothing can be done, or the cluster was lost: the same call does
    the rest.
    """
    found = find(captures)
    if bench and len(found) > 1:
        raise SetupError(f"{bench} is the log of one capture: name that one alone")
    writer(to)
    if jobs is not None and jobs < 1:
        raise SetupError(f"--jobs {jobs}: at least 1 capture at a time")
    if re.match(r"\w{2,}:(?!//)|$", str(out)):  # C: is a drive
        raise SetupError(f"{str(out)!r} is neither a folder nor a URL such as s3://bucket/folder")
    where, tshark = str(out) if "://" in str(out) else os.path.abspath(out), Tshark(**how)
    dataset = DataSet(where, to)
    # Of a single capture its own run says it.
    made = made_by(tshark, tshark.fields()) if len(found) > 1 else None
    dataset.open()
    task = partial(convert_one, out=where, to=to, bench=bench and os.path.abspath(bench), made=made, **how)
    with _executor(scheduler, jobs or os.cpu_count()) as pool:
        done = _run(found, task, pool)
    flights = {result.capture: result.flight_id for result in done.values() if not result.failure}
    for old in dataset.results():  # of a capture that has another content now
        if old.capture in flights and old.flight_id not in flights.values():
            dataset.forget(old)
    return [done[capture] for capture in found]


@contextmanager
def _executor(scheduler: str | None, jobs: int | None) -> Iterator[Executor]:
    """Where the work is done: `jobs` threads, each waiting for a tshark of its own, or the cluster."""
    if scheduler is None:
        pool = ThreadPoolExecutor(jobs)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
        return
    distributed = need("distributed", "fleet")
    try:
        client = distributed.Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise SetupError(f"no Dask scheduler answers at {scheduler}: {error}") from error
    with client:
        yield client.get_executor(pure=False)


def _run(captures: Sequence[Path], task: Callable[[Path], Result], pool: Executor) -> dict[Path, Result]:
    """Convert all, the largest first."""
    largest = sorted(captures, key=lambda capture: capture.stat().st_size if capture.exists() else 0, reverse=True)
    waiting = {pool.submit(task, capture): capture for capture in largest}
    done: dict[Path, Result] = {}
    for future in progress(as_completed(waiting), unit=" captures", total=len(waiting)):
        capture = waiting[future]
        if future.cancelled():
            raise SetupError("the Dask scheduler went away; the same command does the rest")
        error = future.exception()
        if isinstance(error, SetupError):
            raise error
        failed = Result("", str(capture), "", failure=str(error) or type(error).__name__)
        done[capture] = failed if error else future.result()
    return done


def writer(to: str) -> Writer:
    """Return what writes this kind; SetupError where its library is missing."""
    if to not in KINDS:
        raise SetupError(f"no kind {to!r}; known kinds: {', '.join(KINDS)}")
    module, function, extra = KINDS[to]
    found: Writer = getattr(need(f"{__package__}.{module}", extra), function)
    return found


def made_by(tshark: Tshark, fields: Record) -> str:
    """Return what results of this tshark depend on, from its fields.json: plugin, catalogue, options and filter."""
    known = [f"plugin {fields['plugin']}", catalogue_version(fields), *tshark.options]
    known += [f"-C {tshark.profile}"] if tshark.profile else []
    known += [f"bitrate {tshark.bitrate}"] if tshark.bitrate is not None else []
    return "; ".join(known + ([tshark.filter] if tshark.filter else []))


def convert_one(
    capture: StrPath,
    out: str,
    *,
    to: str = "parquet",
    bench: StrPath | None = None,
    made: str | None = None,
    **how: Any,
) -> Result:
    """Convert one capture: a task for Dask, Prefect, Dagster or a loop.

    It may run twice at once, and be killed at any point: the data set then has the flight once, or not yet.

    out, to, bench: as for convert; made: what the machine that gives the order has of plugin and catalogue; this one
    must have the same.

    Returns the Result, whose `failure` says why there is no data. Raises SetupError where no other capture would do
    better on this machine, and YappError where the data set cannot be written.
    """
    capture, tshark, dataset = Path(os.path.abspath(capture)), Tshark(**how), DataSet(out, to)
    dataset.open()
    flight = ""
    try:
        check_file(capture)
        flight = flight_id(capture)
        with BUSY[flight]:
            known = None if bench else dataset.find(flight)
            if known and dataset.has(known.files):
                made = made or made_by(tshark, tshark.fields())
                if known.made_by == made:
                    if known.capture != str(capture) and not os.path.exists(known.capture):  # it was moved
                        known = replace(known, capture=str(capture))
                        dataset.note(known)
                    return known
            return _convert(capture, dataset, tshark, made, Path(bench) if bench else None)
    except SetupError:
        raise
    except OSError as error:
        raise YappError(f"{out}: {error}") from error
    except YappError as error:
        if not made:
            tshark.fields()  # raises SetupError where nothing is wrong with this capture
        return Result(flight, str(capture), made or "", failure=str(error).removeprefix(f"{capture}: "))


def _convert(capture: Path, dataset: DataSet, tshark: Tshark, made: str | None, bench: Path | None) -> Result:
    with dataset.aside() as aside:
        export = tshark.export(capture, aside / "export")
        here = made_by(tshark, export.fields)
        if made and here != made:
            raise SetupError(f"the machine that works on it has another plugin or catalogue: {here}, not {made}")
        flight = Flight(capture, export)
        tables = flight.tables(capture, tshark.options, bench)
        name = f"{SUFFIXES.sub('', capture.name)}-{flight.flight_id[:8]}{'.partial' if export.partial else ''}"
        folder = aside / "result"
        folder.mkdir()
        writer(dataset.to)(tables, folder / name, dataset.url, flight.flight_id)
        files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
        counts = {name: len(rows) for name, rows in tables.items()}
        known = flight.flight_id, str(capture), here, files, counts, export.partial, export.lacks
        result = Result(*known, notes=flight.notes)
        dataset.place(folder, result)
        return result
