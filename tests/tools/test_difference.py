# SPDX-License-Identifier: GPL-2.0-or-later
"""Differences have the digits of what they are differences of."""

import random
from decimal import Decimal

import pyarrow as pa
import pytest
from yapp_tables.difference import difference


def of(first, second):
    """The difference of two numbers, or two lists of numbers."""
    columns = [pa.array(each if isinstance(each, list) else [each]) for each in (first, second)]
    return difference(*columns).to_pylist()


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (0.8, 0.5, 0.3),
        (4000.3, 4000.1, 0.2),
        (36280.18, 41700.6, -5420.42),
        (-0.1, 0.2, -0.3),
        (1e-7, 3e-7, -2e-7),
        (1.234567e-12, 0.0, 1.234567e-12),
        (1.2345678901e-12, 0.0, 1.2345678901e-12),  # the 22nd digit behind the point, and no further one
        (100_000_000_000_000.25, 0.0, 100_000_000_000_000.0),  # fifteen digits
        (0.0, 0.0, 0.0),
        (None, 1.0, None),
        (1.0, None, None),
        (2**53 - 1, 2**53 - 3, 2.0),
        (1e300, 5e299, 5e299),
        (3, 5, -2.0),
    ],
)
def test_difference(first, second, expected):
    assert of(first, second) == [expected]


def test_numbers_of_seven_digits_have_the_difference_that_decimals_have():
    rng, pairs = random.Random(5), []
    for _ in range(20_000):
        size = rng.randrange(-6, 6)
        pairs.append([f"{rng.uniform(-1, 1) * 10 ** (size + rng.randrange(4)):.7g}" for _ in range(2)])
    texts = list(zip(*pairs, strict=True))
    expected = [float(Decimal(first) - Decimal(second)) for first, second in zip(*texts, strict=True)]
    assert of(*([float(text) for text in each] for each in texts)) == expected
