# SPDX-License-Identifier: GPL-2.0-or-later
"""command_lag: from a change of the Command to 63 % of it, of a controller whose time constant is known."""

import math

import pyarrow as pa
import pytest
from yapp_tables.lag import Lags, steps

RATE = 1000  # rows a second


def commands(*rows):
    times, buses, names, values = zip(*rows, strict=True)
    columns = {"time": [round(time * 1e9) for time in times], "bus": buses, "source": names, "rpm": values}
    return pa.table(
        columns, pa.schema([("time", pa.int64()), ("bus", pa.string()), ("source", pa.string()), ("rpm", pa.float64())])
    )


def motor(tau, changes, bus="can0", source=None, number=0x210, seconds=4):
    """A controller that follows each change as a filter of first order."""
    rows, value, target = [], 0.0, 0.0
    for n in range(seconds * RATE):
        now = n / RATE
        target = next((rpm for at, rpm in reversed(changes) if at <= now), 0.0)
        value += (target - value) * (1 - math.exp(-1 / RATE / tau))
        rows.append((n * 10**9 // RATE, bus, source, number, value))
    return rows


def lags(found, rows):
    measured = Lags(found)
    seen = []
    for begin in range(0, len(rows), 700):  # batch by batch
        columns = zip(*rows[begin : begin + 700], strict=True)
        names = ("time", "bus", "source", "id", "rpm_measured")
        types = (pa.int64(), pa.string(), pa.string(), pa.int64(), pa.float64())
        given = {name: pa.array(column, type_) for name, column, type_ in zip(names, columns, types, strict=True)}
        result = measured.measure(given)
        assert result.type == pa.duration("ns")
        seen += result.cast(pa.int64()).to_pylist()
    return [(rows[n][3], lag / 1e9) for n, lag in enumerate(seen) if lag is not None]


def test_each_step_up_and_down_is_measured():
    told = [
        (0.0, "can0", None, 0.0),
        (1.0, "can0", None, 4000.0),
        (1.1, "can0", None, 4000.0),
        (3.0, "can0", None, 1000.0),
    ]
    found = steps(commands(*told), {"rpm": "rpm_measured"})
    assert [step.time for step in found] == [10**9, 3 * 10**9]
    one = motor(0.1, [(1.0, 4000.0), (3.0, 1000.0)])
    other = motor(0.2, [(1.0, 4000.0), (3.0, 1000.0)], number=0x211)
    rows = sorted(one + other)
    assert lags(found, rows) == [
        (0x210, pytest.approx(0.1, abs=0.003)),
        (0x211, pytest.approx(0.2, abs=0.003)),
        (0x210, pytest.approx(0.1, abs=0.003)),
        (0x211, pytest.approx(0.2, abs=0.003)),
    ]


def test_what_is_not_reached_or_of_another_controller_has_no_lag():
    told = [(0.0, "can0", "left", 0.0), (1.0, "can0", "left", 4000.0), (1.05, "can0", "left", 0.0)]
    found = steps(commands(*told), {"rpm": "rpm_measured"})
    assert lags(found, motor(1.0, [(1.0, 4000.0), (1.05, 0.0)], source="left"))[:1] != []  # the way back is short
    assert lags(found[:1], motor(1.0, [(1.0, 4000.0), (1.05, 0.0)], source="left")) == []
    assert lags(found, motor(0.01, [(1.0, 4000.0)], source="right")) == []
    unnamed = steps(commands(*[(at, bus, None, rpm) for at, bus, _, rpm in told]), {"rpm": "rpm_measured"})
    assert lags(unnamed, motor(0.01, [(1.0, 4000.0)], bus="can1")) == []


def test_a_ramp_of_small_steps_has_none():
    told = [(n / 100, "can0", None, float(n)) for n in range(200)]
    assert steps(commands(*told), {"rpm": "rpm_measured"}) == []
