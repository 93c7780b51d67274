# SPDX-License-Identifier: GPL-2.0-or-later
"""What the report's pictures are made of: no extreme and no gap is lost."""

import numpy as np
import pyarrow as pa
import pytest
from yapp_tables.series import Samples, samples, thin


def source(times, every=0.1):
    times = np.asarray(times, float)
    return Samples("esc", "esc", "m", "M", every, {}, times, np.arange(len(times)), {}, set())


@pytest.mark.parametrize("most", [10, 100, 999, 10_000])
def test_extremes_stay(most):
    rng = np.random.default_rng(most)
    values = rng.normal(size=5000)
    values[rng.integers(0, 5000, 50)] = np.nan
    values[[17, 3000]] = 99, -99
    times, (thinned,) = thin(source(np.arange(5000) * 0.1), [values], most)
    assert len(times) == len(thinned) <= most + 2
    assert (np.nanmax(thinned), np.nanmin(thinned)) == (99, -99)
    assert (np.diff(times) >= 0).all()


@pytest.mark.parametrize("most", [100, 10_000])
def test_gaps_stay(most):
    times = np.concatenate([np.arange(2000), np.arange(2600, 4000)]) * 0.1
    thinned, (values,) = thin(source(times), [np.ones(len(times))], most)
    gap = np.flatnonzero(np.isnan(values))
    assert len(gap) == 1
    assert thinned[gap[0] - 1] == pytest.approx(199.9)
    assert thinned[gap[0] + 1] == pytest.approx(260.0)


def test_a_source_is_its_name_or_its_bus_and_id():
    table = pa.table(
        {
            "time": pa.array([3, 1, 2], pa.timestamp("ns", "UTC")),
            "bus": ["can0", None, "can0"],
            "id": pa.array([0x210, 0x210, 0x211], pa.uint32()),
            "source": [None, None, "left"],
            "frame": [1, 2, 3],
        }
    )
    assert [(one.name, one.times.tolist()) for one in samples({"motor": table}, start=1).values()] == [
        ("0x210", [0.0]), ("can0 0x210", [2e-9]), ("left", [1e-9]),
    ]  # fmt: skip
