# SPDX-License-Identifier: GPL-2.0-or-later
"""How long a flight lasted and when it began, where its clock was set or tells no date."""

import pyarrow as pa
import pytest
from yapp_tables.clock import Clock, Stretches, clock_of

NOW = 1_700_000_000


def stretches(*rows):
    """rows: (frame, seconds)."""
    found = Stretches()
    for begin in range(0, len(rows), 2):  # batch by batch
        frames, times = zip(*rows[begin : begin + 2], strict=True)
        found.add(pa.array([round(time * 10**9) for time in times]), pa.array(frames))
    return found


@pytest.mark.parametrize(
    ("tables", "start", "length", "resets"),
    [
        # Two tables of one clock; that of few rows begins later.
        ([((1, NOW), (2, NOW + 5), (9, NOW + 20)), ((4, NOW + 10),)], NOW, 20, 0),
        # A raw dump with a reboot: 4658 s to 4668 s, then 0 s to 9 s.
        ([((1, 4658), (5, 4668), (6, 0), (9, 8)), ((2, 4659), (7, 1), (10, 9))], None, 19, 1),
        # The second table says nothing of the reset.
        ([((1, 4658), (5, 4668), (6, 0), (9, 9)), ((8, 2),)], None, 19, 1),
        # A recorder without a clock gets the time after 10 s.
        ([((1, 0), (2, 10), (3, NOW), (4, NOW + 5))], NOW - 10, 15, 1),
        # Stamps that are out of order by a little are no reset.
        ([((1, NOW), (2, NOW + 1), (3, NOW + 0.5), (4, NOW + 2))], NOW, 2, 0),
        # By more than a second they are; so is a step of more than a day.
        ([((1, NOW), (2, NOW + 1), (3, NOW - 0.5), (4, NOW + 2))], NOW, 3.5, 1),
        ([((1, NOW), (2, NOW + 86_400)), ((3, NOW + 2 * 86_401),)], NOW, 86_400, 1),
        # Just a second back, from one table to the next; the year 2000 begins, and a second before it.
        ([((1, NOW), (2, NOW + 5)), ((3, NOW + 4), (4, NOW + 6))], NOW, 6, 0),
        ([((1, 946_684_800), (2, 946_684_805))], 946_684_800, 5, 0),
        ([((1, 946_684_799), (2, 946_684_805))], None, 6, 0),
        # One table ends before the other begins.
        ([((1, NOW), (2, NOW + 1)), ((3, NOW + 2), (4, NOW + 4))], NOW, 4, 0),
    ],
)
def test_the_clock(tables, start, length, resets):
    found = clock_of(stretches(*rows) for rows in tables)
    assert found == Clock(None if start is None else start * 10**9, length * 10**9, resets)
