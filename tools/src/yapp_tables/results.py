# SPDX-License-Identifier: GPL-2.0-or-later
"""The output folder: which capture has which name, what is up to date, and how a result gets its place at once."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from .errors import SetupError
from .watch import Position, position
from .whole import write_whole

# Raised when files get other names, columns or types: a folder holds results of one layout.
LAYOUT = 2
# Folders left by a run that was killed are removed by the next run, after a day: another run may still be at work.
LEFTOVER_SECONDS = 86400
SUFFIXES = (".gz", ".zst", ".lz4", ".pcapng", ".pcap", ".cap", ".log", ".txt", ".yapp", ".candump")


@dataclass(frozen=True)
class MadeBy:
    """What a result depends on besides its capture."""

    plugin: str
    catalogue: str
    options: tuple[str, ...] = ()
    filter: str | None = None
    layout: int = LAYOUT

    def version(self) -> tuple[str, str, int]:
        """What all results of one folder have in common; options may differ from aircraft to aircraft."""
        return self.plugin, self.catalogue, self.layout


@dataclass(frozen=True)
class Result:
    """What is remembered of a result beside it. capture: absolute path; files: relative to the output folder.

    lacks: sentences on what was not decoded.
    """

    capture: str
    size: int
    modified: int
    made_by: MadeBy
    files: tuple[str, ...] = ()
    messages: int = 0
    partial: str | None = None
    lacks: tuple[str, ...] = ()


def plain_name(capture: Path) -> str:
    """The name of a capture's result where no other capture of the folder has it: `flight` of flight.pcapng.gz."""
    plain = capture.name
    while Path(plain).suffix.lower() in SUFFIXES:
        plain = Path(plain).stem
    return plain


class Results:
    """The results of one kind in one output folder; what is known of them is in its hidden folder `.yapp-tables`."""

    def __init__(self, out: Path, to: str) -> None:
        """to: the kind, "parquet"."""
        self.out, self.to = out, to
        self._notes = out / ".yapp-tables"
        self._work = self._notes / f"work-{uuid.uuid4().hex}"

    def open(self, captures: Iterable[Path], made_by: MadeBy) -> None:
        """Make the folder; SetupError where it cannot be written, or would hold results of two versions."""
        try:
            self._work.mkdir(parents=True)
        except OSError as error:
            raise SetupError(f"{self.out} cannot be written: {error.strerror}") from error
        given = {str(capture) for capture in captures}
        for note in self._notes.glob(f"*.{self.to}.json"):
            made = self._read(note)
            if made is None or (made.made_by.version() != made_by.version() and made.capture not in given):
                self.close()
                was = f"plugin {made.made_by.plugin}, catalogue {made.made_by.catalogue}" if made else "unknown"
                raise SetupError(
                    f"{self.out} has results of another version ({note.stem}: {was}): "
                    "convert their captures again too, or choose another folder"
                )

    def close(self) -> None:
        """Remove what this run, or one that was killed more than a day ago, left aside."""
        shutil.rmtree(self._work, ignore_errors=True)
        for work in self._notes.glob("work-*"):
            if time.time() - work.stat().st_mtime > LEFTOVER_SECONDS:
                shutil.rmtree(work, ignore_errors=True)

    def names(self, captures: Iterable[Path]) -> dict[Path, str]:
        """A name for each capture, the same each time: `flight`, `flight-1a2b3c4d` where another has that one."""
        names: dict[Path, str] = {}
        taken: set[str] = set()
        for capture in captures:
            plain = plain_name(capture)
            long = f"{plain}-{hashlib.sha256(str(capture).encode()).hexdigest()[:8]}"
            owner = self.find(plain)
            free = plain not in taken and (owner is None or owner.capture == str(capture))
            names[capture] = plain if free and self.find(long) is None else long
            taken.add(names[capture])
        return names

    def find(self, name: str) -> Result | None:
        """The result of this name, if there is one."""
        return self._read(self._note(name))

    def current(self, name: str, capture: Path, made_by: MadeBy) -> Result | None:
        """The result of this name where it is up to date: same capture, unchanged, made by the same, files there."""
        made = self.find(name)
        if made is None or (made.capture, made.made_by) != (str(capture), made_by):
            return None
        state = capture.stat() if capture.exists() else None
        same = state is not None and (state.st_size, state.st_mtime_ns) == (made.size, made.modified)
        return made if same and all((self.out / file).is_file() for file in made.files) else None

    @contextmanager
    def aside(self) -> Iterator[Path]:
        """A folder to write to, on the same file system and of this task alone; removed at the end."""
        folder = self._work / uuid.uuid4().hex
        folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def position(self) -> Position:
        """How far the captures are that are at work in this run, on whatever machine."""
        return position(self._work)

    def place(self, name: str, folder: Path, made: Result) -> Result:
        """Rename all files in folder to their place, and what an older result of this name has left away."""
        files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
        made = replace(made, files=tuple(files))
        before = self.find(name)
        for file in files:
            target = self.out / file
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(folder / file, target)
        for file in set(before.files if before else ()) - set(files):
            (self.out / file).unlink(missing_ok=True)
        # Last: a result that was cut off half-way is not known, and is made again.
        write_whole(self._note(name), json.dumps(asdict(made), indent=1))
        return made

    def _note(self, name: str) -> Path:
        return self._notes / f"{name}.{self.to}.json"

    def _read(self, note: Path) -> Result | None:
        try:
            record = json.loads(note.read_text(encoding="utf-8"))
            made_by = record.pop("made_by")
            made_by["options"] = tuple(made_by["options"])
            return Result(
                **{
                    **record,
                    "files": tuple(record["files"]),
                    "lacks": tuple(record["lacks"]),
                    "made_by": MadeBy(**made_by),
                }
            )
        except (OSError, ValueError, TypeError, KeyError):
            return None
