# SPDX-License-Identifier: GPL-2.0-or-later
"""What the person at the keyboard is told: errors, each as a sentence, counts, and the progress of long work."""

import importlib
import sys
from collections.abc import Iterable
from types import ModuleType
from typing import Any


class YappError(Exception):
    """A sentence that says what is wrong and what to do about it."""


class SetupError(YappError):
    """Something is wrong with the machine or the command, not with a capture: no other capture would do better."""


class CaptureError(YappError):
    """Something is wrong with this capture; another try would say the same."""


def count_of(number: int, noun: str) -> str:
    """Return "1 flight", "2,000 flights"."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def progress(work: Iterable[Any], **how: Any) -> Iterable[Any]:
    """Return the same work, with a bar in a terminal. how: keywords of tqdm."""
    return importlib.import_module("tqdm").tqdm(work, leave=False, **how) if sys.stderr.isatty() else work


def need(module: str, extra: str) -> ModuleType:
    """Import a module that needs the library of an extra. Raises SetupError with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise SetupError(f"{error.name or module} is missing ({error}): pip install 'yapp-tables[{extra}]'") from error
