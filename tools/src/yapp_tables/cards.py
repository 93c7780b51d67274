# SPDX-License-Identifier: GPL-2.0-or-later
"""The cards of faults, as -z yapp,fault tells them: what changed before a fault, and what else happened."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from .tshark import Record, Tshark

MOST = 8  # cards of a page


def read(capture: Path, tshark: Tshark, numbers: Iterable[int]) -> tuple[list[Record], list[str]]:
    """Return the cards of these faults, from 1, each with its `text`, and what the plugin says of them."""
    wanted = [f"fault,{number}{form}" for number in numbers for form in (",json", "")]
    rows, said, text = tshark.ask(capture, wanted)
    texts = re.split("(?m)^(?=YAPP fault: )", text)[1:]
    return [row | {"text": own} for row, own in zip(rows, texts, strict=False) if row.get("incident") is not None], said
