# SPDX-License-Identifier: GPL-2.0-or-later
"""Folders to work in: removed when the work is done, and by the next run where a run was killed."""

from __future__ import annotations

import errno
import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from .errors import SetupError

LEFTOVER_SECONDS = 86400
HOST = re.sub(r"\W", "_", platform.node()) or "host"
NAME = re.compile(r"work-(?P<run>\w*)-(?P<host>\w+)-(?P<pid>\d+)-")


@contextmanager
def scratch(parent: str | os.PathLike[str] | None = None, run: str = "") -> Iterator[Path]:
    """Make a folder of this task alone, in parent or where temporary files are. Raises SetupError on a full disk."""
    where = str(parent or tempfile.gettempdir())
    if not parent:
        _clean_once(where)
    advice = "" if parent else ", or set TMPDIR to a folder with more"
    try:
        with tempfile.TemporaryDirectory(prefix=f"work-{run}-{HOST}-{os.getpid()}-", dir=where) as folder:
            yield Path(folder)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise SetupError(f"the disk is full: {error.filename or where}; free some space there{advice}") from error


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, in place of one that is there: nobody ever reads half of it. Raises OSError."""
    aside = path.with_name(f".{path.name}.part")
    try:
        aside.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def clean(parent: str | os.PathLike[str] | None = None, run: str = "") -> None:
    """Remove what this run left, and every run of this machine that is dead, or of another one a day ago."""
    for folder in Path(parent or tempfile.gettempdir()).glob("work-*-*-*-*"):
        match = NAME.match(folder.name)
        if match and ((run and match["run"] == run) or _is_dead(match, folder)):
            shutil.rmtree(folder, ignore_errors=True)


@cache
def _clean_once(where: str) -> None:
    clean(where)


def _is_dead(match: re.Match[str], folder: Path) -> bool:
    if match["host"] == HOST and os.name == "posix":
        try:
            os.kill(int(match["pid"]), 0)
        except ProcessLookupError:
            return True
        except OSError:  # of another user: it lives
            pass
        return False
    try:
        return time.time() - folder.stat().st_mtime > LEFTOVER_SECONDS
    except OSError:
        return False
