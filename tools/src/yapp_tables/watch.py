# SPDX-License-Identifier: GPL-2.0-or-later
"""How far a running tshark is, for who waits for one large file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from .whole import write_whole

PROGRESS = "progress"


@dataclass(frozen=True)
class Position:
    """Of captures at work: bytes that were read, messages that were written."""

    bytes: int = 0
    messages: int = 0


NOWHERE = Position()


class Watch:
    """Notes now and then, in a file that another machine can read, how far the run over one capture is."""

    def __init__(self, note: Path, capture: Path) -> None:
        """note: the file; capture: what is read."""
        self.note, self.capture = note, capture.resolve()
        self._read: dict[str, int] = {}
        self._lines = 0

    def look(self, pid: int, tables: Path) -> None:
        """Note where the process with this number is. tables: the folder it writes its CSV files to."""
        for path in tables.glob("*.csv*"):
            self._count(path)
        # The first line of a table is its header.
        write_whole(self.note, f"{self._bytes(pid)} {max(0, self._lines - len(self._read))}")

    def _count(self, path: Path) -> None:
        name = path.name.removesuffix(".part")
        try:
            with path.open("rb") as file:
                file.seek(self._read.get(name, 0))
                while block := file.read(1 << 20):
                    self._lines += block.count(b"\n")
                self._read[name] = file.tell()
        except FileNotFoundError:  # renamed while we look: the run is about to end
            pass

    def _bytes(self, pid: int) -> int:
        """Where the process is in its capture; 0 where the system does not tell: Linux does."""
        try:
            for link in Path(f"/proc/{pid}/fd").iterdir():
                if os.readlink(link) == str(self.capture):
                    about = Path(f"/proc/{pid}/fdinfo/{link.name}").read_text(encoding="ascii")
                    return int(about.split()[1])  # pos: 4096
        except (OSError, ValueError, IndexError):
            pass
        return 0


def position(work: Path) -> Position:
    """The sum of what the notes below a folder say."""
    read = messages = 0
    for note in work.glob(f"*/{PROGRESS}"):
        try:
            words = note.read_text(encoding="ascii").split()
        except OSError:  # its capture is done
            continue
        read, messages = read + int(words[0]), messages + int(words[1])
    return Position(read, messages)
