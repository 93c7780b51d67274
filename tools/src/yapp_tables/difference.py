# SPDX-License-Identifier: GPL-2.0-or-later
"""The difference of two columns with the digits that these have: 0.3, not 0.30000000000000004, for 0.8 less 0.5."""

from __future__ import annotations

from array import array

import pyarrow as pa
import pyarrow.compute as pc

from .scalars import scalar

# A double has so many decimal digits for sure: what is behind them in a difference comes of binary fractions.
DIGITS = 15
# A double has these powers of ten exactly.
POWERS = pa.Array.from_buffers(pa.float64(), 23, [None, pa.py_buffer(array("d", [10.0**n for n in range(23)]))])


def difference(of: pa.Array, less: pa.Array) -> pa.Array:
    """Return of - less, rounded to the fifteenth digit of the larger one of the two; null where one is null.

    4000.3 less 4000.1 is 0.2: the digit is that of 0.00000000001, and a double of 4000.1 errs by less.
    """
    of, less = of.cast(pa.float64()), less.cast(pa.float64())
    largest = pc.max_element_wise(pc.abs(of), pc.abs(less), skip_nulls=False)
    places = pc.subtract(scalar(DIGITS - 1.0), pc.floor(pc.log10(largest)))  # of 0: infinite
    places = pc.min_element_wise(pc.max_element_wise(places, scalar(0.0)), scalar(len(POWERS) - 1.0))
    power = pc.take(POWERS, places.cast(pa.int32()))
    return pc.divide(pc.round(pc.multiply(pc.subtract(of, less), power)), power)
