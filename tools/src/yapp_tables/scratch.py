# SPDX-License-Identifier: GPL-2.0-or-later
"""Folders to work in: removed when the work is done, and a day later where a run was killed."""

import errno
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import SetupError

PREFIX, LEFTOVER_SECONDS = "yapp-tables-work-", 86400


@contextmanager
def scratch(parent: str | os.PathLike[str] | None = None) -> Iterator[Path]:
    """Make a folder of this task alone, in parent or where temporary files are. Raises SetupError on a full disk."""
    where = Path(parent or tempfile.gettempdir())
    advice = "" if parent else ", or set TMPDIR to a folder with more"
    for left in where.glob(f"{PREFIX}*"):  # by a run that was killed
        with suppress(FileNotFoundError):  # its run has just ended
            if time.time() - left.stat().st_mtime > LEFTOVER_SECONDS:
                shutil.rmtree(left, ignore_errors=True)
    try:
        with tempfile.TemporaryDirectory(prefix=PREFIX, dir=where) as folder:
            yield Path(folder)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise SetupError(f"the disk is full: {error.filename or where}; free some space there{advice}") from error


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, in place of one that is there: nobody ever reads half of it. Raises SetupError."""
    aside = path.parent / f".{path.name}.part"
    try:
        aside.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(aside, path)
    except OSError as error:
        raise SetupError(f"{path} cannot be written: {error.strerror}") from error
    finally:
        with suppress(OSError):
            aside.unlink()
