# SPDX-License-Identifier: GPL-2.0-or-later
"""Times as people read them, on the page of a flight: seconds have three decimals everywhere."""

from __future__ import annotations

from datetime import UTC, datetime


def duration(seconds: float) -> str:
    """Return `0.450 s`, `40.504 s`, `2 min 24.000 s`."""
    minutes, rest = divmod(round(seconds * 1000), 60_000)
    return f"{minutes} min {rest / 1000:.3f} s" if minutes else f"{rest / 1000:.3f} s"


def about(seconds: float) -> str:
    """Return a duration for a headline: `0.9 s`, `40 s`, `2 min 24 s`."""
    if seconds < 9.95:
        return f"{seconds:.2g} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def clock(seconds: float) -> str:
    """Return 612.439 as `10:12.439`."""
    minutes, rest = divmod(round(abs(seconds) * 1000), 60_000)
    return f"{'-' * (seconds < 0)}{minutes}:{rest // 1000:02}.{rest % 1000:03}"


def minute(seconds: float) -> str:
    """Return 612.439 as `10:12`, where thousandths mean nothing."""
    return f"{int(seconds) // 60}:{int(seconds) % 60:02}"


def utc(epoch: float, seconds: float) -> str:
    """Return the time of day in UTC, `14:33:32.037`."""
    whole, part = divmod(round((epoch + seconds) * 1000), 1000)
    return f"{datetime.fromtimestamp(whole, UTC):%H:%M:%S}.{part:03}"
