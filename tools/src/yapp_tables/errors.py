"""What can go wrong, each as a sentence for the person at the keyboard."""

from __future__ import annotations

import importlib
from types import ModuleType


class YappError(Exception):
    """A sentence that says what is wrong and what to do about it."""


class SetupError(YappError):
    """Something is wrong with the machine or the command, not with a capture: no other capture would do better."""


class CaptureError(YappError):
    """Something is wrong with this capture; another try would say the same."""


def need(module: str, extra: str) -> ModuleType:
    """Import an optional library.

    module: its name, "plotly.offline". extra: the extra of this package that brings it, "report".
    Raises SetupError with the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise SetupError(f"{library} is missing ({error}): pip install 'yapp-tables[{extra}]'") from error
