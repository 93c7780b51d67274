# SPDX-License-Identifier: GPL-2.0-or-later
"""Captures of YAPP and Taurus as tables: tshark and the plugin decode, pyarrow stores.

`how` are the keywords of Tshark.
"""

from importlib.metadata import version

from .convert import convert, convert_one
from .dataset import Result
from .errors import CaptureError, SetupError, YappError
from .flight import Flight, read
from .report import report
from .tshark import Tshark

__version__ = version("yapp-tables")
__all__ = [
    "CaptureError", "Flight", "Result", "SetupError", "Tshark", "YappError", "convert", "convert_one", "read", "report",
]  # fmt: skip
