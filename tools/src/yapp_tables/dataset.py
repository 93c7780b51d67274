# SPDX-License-Identifier: GPL-2.0-or-later
"""A data set in a folder or a cloud: which flights it has, what is up to date, how a result gets its place at once."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pyarrow import fs

from .errors import SetupError, need
from .scratch import scratch
from .tables import SCHEMA

StrPath = str | os.PathLike[str]
NOTES = ".yapp-tables"


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


def flight_id(capture: Path) -> str:
    """Return the name of a capture's content: the first 16 digits of its SHA-256."""
    with capture.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


class DataSet:
    """The results of one kind. What is known of them lies beside the data, in `<out>.yapp-tables/<kind>`."""

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
        self.notes = f"{self.beside}/{to}"
        self.url = self.path if self.is_local else out.rstrip("/")

    def open(self) -> None:
        """Make the folder of notes; SetupError where it cannot be written, or has results of another version."""
        try:
            if self.fs.get_file_info(self.path).is_file:
                raise FileExistsError("it is a file")
            if self.is_local:
                Path(self.notes).mkdir(parents=True, exist_ok=True)
            # In this order: others open it at the same time, and note a flight only behind the version.
            is_empty = not self._flights()
            version = (self._read("version/schema") or {}).get("version", "5 or older")
            if version != SCHEMA and is_empty:
                self._write("version/schema", {"version": SCHEMA})
            elif version != SCHEMA:
                again = f"yapp-tables convert CAPTURES --to {self.to} --out {self.path}-{SCHEMA}"
                raise SetupError(
                    f"{self.path} has version {version} of the tables, not {SCHEMA}; make it anew: {again}"
                )
        except OSError as error:
            raise SetupError(f"{self.path} cannot be written: {error.strerror or error}") from error

    def find(self, flight: str) -> Result | None:
        """Return what is known of a flight."""
        record = self._read(flight)
        return Result(**record) if record else None

    def results(self) -> Iterator[Result]:
        """Return what is known of all flights, several notes asked for at once."""
        with ThreadPoolExecutor() as pool:
            yield from filter(None, pool.map(self.find, self._flights()))

    def _flights(self) -> list[str]:
        found = self.fs.get_file_info(fs.FileSelector(self.notes, allow_not_found=True))
        return sorted(info.base_name.removesuffix(".json") for info in found if info.extension == "json")

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
        """Remember a result."""
        self._write(result.flight_id, asdict(result))

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

    def _write(self, name: str, record: dict[str, Any]) -> None:
        """Write a note at once: whoever reads it meanwhile has the old one or the new one."""
        with self.aside() as folder:
            note = folder / "note.json"
            note.write_text(json.dumps(record, indent=1), encoding="utf-8")
            self._move(note, f"{self.notes}/{name}.json")

    def _read(self, name: str) -> dict[str, Any] | None:
        try:
            record: dict[str, Any] = json.loads(self.fs.open_input_stream(f"{self.notes}/{name}.json").read())
            return record
        except (OSError, ValueError):
            return None
