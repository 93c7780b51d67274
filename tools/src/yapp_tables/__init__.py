# SPDX-License-Identifier: GPL-2.0-or-later
"""Captures of YAPP and Taurus as tables: tshark and the plugin decode, pyarrow stores."""

from importlib.metadata import version

from .api import convert, read, read_many, report
from .config import Config
from .convert import convert_one
from .dataset import Result
from .errors import CaptureError, MessageError, SetupError, YappError
from .flight import Flight
from .tshark import Tshark

__version__ = version("yapp-tables")
__all__ = [
    "CaptureError", "Config", "Flight", "MessageError", "Result", "SetupError", "Tshark", "YappError", "convert",
    "convert_one", "read", "read_many", "report",
]  # fmt: skip
