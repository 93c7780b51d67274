# SPDX-License-Identifier: GPL-2.0-or-later
"""Which controller is different: none in 100 flights without one, all of 20 planted ones, and at the right time."""

import re

import numpy as np
import pyarrow as pa
import pytest
from yapp_tables.differs import differing
from yapp_tables.series import Source
from yapp_tables.tables import Column, Message

FIELDS = {
    "rpm_commanded": "RPM", "rpm_measured": "RPM", "dc_voltage": "V", "dc_current": "A", "esc_temperature": "°C",
    "motor_temperature": "°C",
}  # fmt: skip
MESSAGE = Message(
    "motor", "Motor Data", 0.1, {name: Column(name, pa.float64(), "value", name, unit) for name, unit in FIELDS.items()}
)


def filtered(values, share):
    out, state = np.empty_like(values), values[0]
    for at, value in enumerate(values):
        state += share * (value - state)
        out[at] = state
    return out


def flight(seed, count, hot=None, bad=None, off=None, load=None):
    """Motor Data of some controllers that fly the same, each a bit in its own way."""
    rng = np.random.default_rng(seed)
    seconds = int(rng.integers(150, 500))
    times = np.arange(0, seconds, 0.1)
    phases = rng.uniform(0, 6, 3)
    base = (
        3500
        + 900 * np.sin(times / rng.uniform(8, 40) + phases[0])
        + 400 * np.sin(times / rng.uniform(2, 6) + phases[1])
    )
    base[: len(base) // 20] = 0  # on the ground
    since = int(rng.integers(40, 90))
    found = []
    for number in range(count):
        own = times + rng.uniform(0, 0.1)
        command = np.where(base > 0, base + rng.uniform(20, 150) * np.sin(times / 7 + number), 0)
        speed = filtered(command, 0.2 if number == bad else rng.uniform(0.5, 0.65)) + rng.normal(0, 8, len(times))
        current = 5 + (speed / 4000) ** 2 * 10 * rng.uniform(0.95, 1.05) + rng.normal(0, 0.3, len(times))
        if number == load:
            current = current * 1.6
        heat = 35 + rng.uniform(10, 30) * 0.2 + 25 * (1 - np.exp(-times / 150)) + rng.uniform(-2.5, 2.5)
        esc = heat + rng.normal(0, 0.5, len(times)) + (14 * (times > since) if number == hot else 0)
        special = np.where(rng.random(len(times)) < 0.003, "nan", None)
        if number == off:
            special[:] = "nan"
        gone = rng.random(len(times)) < 0.01
        columns = [command, speed, 48 - current * 0.05, current, np.where(special == "nan", np.nan, esc), heat + 6]
        table = dict(zip(FIELDS, columns, strict=True)) | {"esc_temperature_special": pa.array(special, pa.string())}
        found.append(Source(f"esc{number}", pa.table(table).filter(pa.array(~gone)), own[~gone], 0.1))
    return found, since


@pytest.mark.parametrize("first", range(0, 100, 10))
def test_none_in_100_clean_flights(first):
    for seed in range(first, first + 10):
        found, _ = flight(seed, 2 + seed % 7)
        assert differing(MESSAGE, found, set()) == [], seed


@pytest.mark.parametrize("seed", range(20))
def test_all_of_20_planted_ones(seed):
    kind = ("hot", "bad", "off", "load")[seed % 4]
    count = 4 + seed % 5
    who = seed % count
    found, since = flight(1000 + seed, count, **{kind: who})
    said = differing(MESSAGE, found, set())
    assert {row["source"] for row in said} == {f"esc{who}"}
    when = f"({since - 1}|{since}|{since + 1})"
    texts = {
        "hot": rf"esc_temperature 1[1-7] °C hotter than the median of the others from {when} s on",
        "bad": r"rpm_measured follows its command \d\.\d times worse than the others",
        "off": "esc_temperature not connected, whole flight", "load": "dc_current .* A higher than the median",
    }  # fmt: skip
    assert any(re.search(texts[kind], row["text"]) for row in said)
    if kind == "hot":
        assert abs(said[0]["at"] - since) <= 2


def test_of_two_the_hot_one_is_said():
    found, _ = flight(7, 2, hot=1)
    assert [row["source"] for row in differing(MESSAGE, found, set())] == ["esc1"]
