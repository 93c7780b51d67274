# SPDX-License-Identifier: GPL-2.0-or-later
"""Captures of YAPP and Taurus as tables: tshark and the plugin decode, pyarrow stores."""

from importlib.metadata import version

from .api import convert, read, report
from .convert import Config, convert_one
from .dataset import Result
from .errors import CaptureError, MessageError, SetupError, YappError
from .flight import Flight
from .tshark import Tshark

__version__ = version("yapp-tables")
__all__ = [
    "CaptureError", "Config", "Flight", "MessageError", "Result", "SetupError", "Tshark", "YappError", "convert",
    "convert_one", "read", "report",
]  # fmt: skip
