# SPDX-License-Identifier: GPL-2.0-or-later
"""Captures of YAPP and Taurus as tables: tshark and the plugin decode, pyarrow stores.

`how` are the keywords of Tshark.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .dataset import Result, convert, convert_one
    from .errors import CaptureError, SetupError, YappError
    from .flight import Flight, read
    from .report_page import report
    from .tshark import Tshark

__version__ = "3.0.0"
__all__ = [
    "CaptureError", "Flight", "Result", "SetupError", "Tshark", "YappError", "convert", "convert_one", "read", "report",
]  # fmt: skip
MODULES = ("errors", "tshark", "flight", "dataset", "report_page")


def __getattr__(name: str) -> Any:
    """Import what is asked for: numpy and Arrow take 0.3 s, and `yapp-tables install` needs neither."""
    if name in __all__:
        modules = (importlib.import_module(f".{module}", __name__) for module in MODULES)
        return next(getattr(module, name) for module in modules if hasattr(module, name))
    raise AttributeError(f"module {__name__} has no attribute {name}")
