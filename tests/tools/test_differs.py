# SPDX-License-Identifier: GPL-2.0-or-later
"""Which controller is different: none in 100 flights without one, all planted ones, and at the right time."""

import numpy as np
import pytest
from yapp_tables import differs
from yapp_tables.series import Samples

FIELDS = {
    "rpm_commanded": "RPM", "rpm_measured": "RPM", "dc_voltage": "V", "dc_current": "A", "esc_temperature": "°C",
    "motor_temperature": "°C",
}  # fmt: skip
ABOUT = {name: {"role": "value", "unit": unit} for name, unit in FIELDS.items()}


def samples(name, times, columns, every=0.1, about=ABOUT):
    return Samples(name, name, "motor", "Motor Data", every, about, times, np.arange(len(times)), columns, set())


def differing(found, flight=(), excused=()):
    """What is said of sources; excused: stretches in which nobody is compared."""
    for one in found:
        one.calm = differs.calm_samples(one, flight, excused)
    return differs.differing(found)


def filtered(values, share):
    out, state = np.empty_like(values), values[0]
    for at, value in enumerate(values):
        state += share * (value - state)
        out[at] = state
    return out


def flight(seed, count, hot=None, load=None):
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
        speed = filtered(command, rng.uniform(0.5, 0.65)) + rng.normal(0, 8, len(times))
        current = 5 + (speed / 4000) ** 2 * 10 * rng.uniform(0.95, 1.05) + rng.normal(0, 0.3, len(times))
        if number == load:
            current = current * 1.6
        heat = 35 + rng.uniform(10, 30) * 0.2 + 25 * (1 - np.exp(-times / 150)) + rng.uniform(-2.5, 2.5)
        esc = heat + rng.normal(0, 0.5, len(times)) + (14 * (times > since) if number == hot else 0)
        esc[rng.random(len(times)) < 0.003] = np.nan
        there = rng.random(len(times)) >= 0.01
        columns = [command, speed, 48 - current * 0.05, current, esc, heat + 6]
        columns = {name: values[there] for name, values in zip(FIELDS, columns, strict=True)}
        found.append(samples(f"esc{number}", own[there], columns))
    return found, since


@pytest.mark.parametrize("first", range(0, 100, 10))
def test_none_in_100_clean_flights(first):
    for seed in range(first, first + 10):
        found, _ = flight(seed, 2 + seed % 7)
        assert differing(found) == [], seed


@pytest.mark.parametrize("seed", [seed for seed in range(27) if seed % 3 != 1])
def test_all_planted_ones(seed):
    kind = ("hot", "", "load")[seed % 3]
    count = 4 + seed % 5
    who = seed % count
    found, since = flight(1000 + seed, count, **{kind: who})
    said = differing(found)
    assert {row["source"] for row in said} == {f"esc{who}"}
    what = {"hot": ("esc_temperature", "temperature"), "load": ("dc_current", "level")}[kind]
    assert what in {(row["title"], row["kind"]) for row in said}
    if kind == "hot":
        assert abs(said[0]["at"] - since) <= 2
        assert 10 < said[0]["away"] < 18


def sources(*values, every=1.0):
    """Sources with these values at one time each second; None where a message is missing."""
    found = []
    for number, own in enumerate(values):
        known = [at for at, value in enumerate(own) if value is not None]
        columns = {"value": np.array([float(own[at]) for at in known])}
        found.append(samples(f"esc{number}", np.array(known) * every, columns, every))
    return found, [one.columns["value"] for one in found]


def test_the_values_of_each_second():
    """The mean of a second; the one before for five more."""
    one = samples("one", np.array([0.2, 0.7, 1.5, 9.0]), {})
    other = samples("other", np.array([-0.5, 2.0, 3.0]), {})
    grid = differs._by_second([one, other], [np.array([1.0, 3, 5, 7]), np.array([1.0, 4, np.nan])])
    nan = np.nan
    np.testing.assert_array_equal(grid, [[2, 5, 5, 5, 5, 5, 5, nan, nan, 7], [nan, nan, 4, 4, 4, 4, 4, 4, nan, nan]])


@pytest.mark.parametrize(
    ("value", "seconds", "word"),
    [(30, 25, False), (30.5, 25, True), (0, 25, False), (-0.5, 25, True), (31, 20, True), (31, 19, False)],
)
def test_how_far_and_how_long_a_temperature_is_apart(value, seconds, word):
    """More than 10 degrees above, or 20 below, for 20 s."""
    found, values = sources([20] * 50, [20] * 50, [20] * 5 + [value] * seconds + [20] * (45 - seconds))
    said = differs._temperature(found, values)
    about = [(row["number"], row["at"], row["end"], row["away"]) for row in said]
    assert about == ([(2, 5.0, 5.0 + seconds, value - 20)] if word else [])


@pytest.mark.parametrize(
    ("others", "value", "is_odd"),
    [
        ((10, 10, 10.2), 12.5, False), ((10, 10, 10.2), 12.6, True), ((10, 10, 10.2), 7.4, True),
        ((1, 1, 1), 2, False), ((1, 1, 1), 2.1, True),
        ((10, 11, 10.5), 14.4, False), ((10, 11, 10.5), 14.6, True), ((1, 1), 9, False),
        ((10, 10, 10, 1, 1, 1, 1), 10, False),
    ],
)  # fmt: skip
def test_how_far_a_level_is_apart(others, value, is_odd):
    """A quarter of the level, 8 times as far as two thirds of the others lie apart, and 1; three have to agree."""
    found, values = sources(*([each] * 9 for each in (*others, value)))
    said = [(row["number"], row["value"], row["beside"]) for row in differs._level(found, values)]
    assert said == ([(len(others), value, np.median(others))] if is_odd else [])


@pytest.mark.parametrize(
    ("value", "steps", "others", "times"),
    [(18, 2, 10, None), (18.2, 2, 10, 1.82), (30, 1, 10, None), (10, 2, 1, 10.0), (9.9, 2, 1, None)],
)
def test_a_multiple_of_the_others(value, steps, others, times):
    """1.8 times, for two messages, and further away than 10 % of the largest value of the flight."""
    usual = [others] * 99 + [89.0 if others == 1 else 10]  # the largest value, of all
    own = usual[:40] + [value] * steps + usual[40 + steps :]
    late = [*usual[:40], None, *usual[41:]]  # the one before stands there
    found, values = sources(usual, late, own)
    said = differs._surges(found, values)
    about = [(row["number"], row["times"], row["at"], row["end"], row["value"]) for row in said]
    assert about == ([(2, pytest.approx(times), 40.0, 42.0, value)] if times else [])


@pytest.mark.parametrize("fallen", [(4,), (4, 5), (3, 4, 5), (2, 3, 4, 5)])
def test_who_did_not_fall_is_innocent_and_so_is_who_spins_up(fallen):
    """Some of six fall together, as after a Command that was disabled, then draw a multiple."""
    usual = [20.0] * 300
    down = [20.0] * 40 + [0.5] * 5 + [50.0] * 4 + [20.0] * 251
    found, values = sources(*(down if number in fallen else usual for number in range(6)))
    assert [row["number"] for row in differs._surges(found, values)] == ([4] if fallen == (4,) else [])


def test_a_flight_is_where_most_turn():
    """From the ground to the ground; a break of 4 s is none, one of 6 s is one."""
    speed = [0.0] * 10 + [3000.0] * 30 + [100.0] * 4 + [3000.0] * 20 + [0.0] * 6 + [3000.0] * 20 + [0.0] * 10
    times = np.arange(len(speed)) + 0.5
    about = {name: {"role": "value", "unit": "RPM"} for name in ("rpm_measured", "rpm_commanded")}
    found = [samples("esc0", times, dict.fromkeys(about, np.array(speed)), 1.0, about)] * 3
    assert differs.flying(found) == [(10, 64), (70, 90)]
    assert differs.calm_samples(found[0], [(10, 64)], [(20, 30)]).sum() == 44


@pytest.mark.parametrize(
    ("speeds", "amperes", "said"),
    [
        ((3300, 3300, 3300, 3300, 3500), (20, 20, 20, 20, 26), []),  # it turns faster, and nobody as fast
        ((3300, 3300, 3300, 3300, 3100), (20, 20, 20, 20, 26), [(4, 26, 20)]),
        ((3300, 3300, 3300, 3500, 3500), (20, 20, 20, 24, 32), [(4, 32, 24)]),
        ((3300, 3300, 3300, 3500, 3500), (20, 20, 20, 24, 28), []),
    ],
)
def test_a_level_is_compared_at_the_same_speed(speeds, amperes, said):
    times, found = np.arange(0, 60, 0.1), []
    for number, (speed, current) in enumerate(zip(speeds, amperes, strict=True)):
        columns = [np.full(len(times), value) for value in (speed, speed, 48.0, current, 40.0, 50.0)]
        found.append(samples(f"m{number}", times, dict(zip(FIELDS, columns, strict=True))))
    rows = [row for row in differing(found) if row["kind"] == "level" and row["field"] == "dc_current"]
    assert [(int(row["source"][1:]), row["value"], row["beside"]) for row in rows] == said
