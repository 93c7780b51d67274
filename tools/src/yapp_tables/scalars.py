# SPDX-License-Identifier: GPL-2.0-or-later
"""Arrow scalars that do not import pandas, as pa.scalar and pa.array do where it is installed.

That takes as long as to write a flight of half an hour.
"""

from __future__ import annotations

from array import array

import pyarrow as pa

TYPES = {"q": pa.int64(), "d": pa.float64()}


def scalar(value: int | float) -> pa.Scalar:
    """Return a scalar, int64 or float64."""
    code = "q" if isinstance(value, int) else "d"
    return pa.Array.from_buffers(TYPES[code], 1, [None, pa.py_buffer(array(code, [value]))])[0]
