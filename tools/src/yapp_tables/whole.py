# SPDX-License-Identifier: GPL-2.0-or-later
"""Small files that are written aside and renamed: nobody ever reads half of one."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def write_whole(path: Path, text: str) -> None:
    """Write a file, in place of one that is there. Raises OSError, and then leaves nothing behind."""
    aside = path.with_name(f".{path.name}.part")
    try:
        aside.write_text(text, encoding="utf-8", newline="")
        os.replace(aside, path)
    except OSError:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise
