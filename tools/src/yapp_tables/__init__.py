# SPDX-License-Identifier: GPL-2.0-or-later
"""Captures of YAPP and Taurus as tables: tshark and the plugin decode, pyarrow stores."""

from .errors import CaptureError, MessageError, SetupError, YappError
from .flight import Flight, read

__all__ = ["CaptureError", "Flight", "MessageError", "SetupError", "YappError", "read"]
