# SPDX-License-Identifier: GPL-2.0-or-later
"""The page names whom an incident hit, with what it was, and nobody else. planted.py judges more flights."""

import re

import planted
import pytest


@pytest.mark.parametrize(
    ("seed", "kinds"), [(1, planted.KINDS), (2, ()), (3, ("disabled", "lost", "sag")), (4, ("load", "hot", "disabled"))]
)
def test_nobody_else_is_accused(tmp_path, seed, kinds):
    truth, lines = planted.judge(tmp_path, seed, 150.0, kinds)
    guilty = {"Battery" if name == "battery" else name for name, *_ in truth.values()}
    assert set(lines) == guilty, lines
    for kind, (name, *_) in truth.items():
        assert re.search(planted.WORDS[kind], lines["Battery" if name == "battery" else name]), (kind, lines)
    page = (tmp_path / "page.html").read_text()
    verdict = re.sub("<.*?>", "", re.search(r'<p id="verdict">(.*?)</p>', page)[1])
    if not truth:
        assert verdict.startswith("GOOD: no fault, reboot, silence or odd controller"), verdict
    else:
        assert verdict.startswith("NOT GOOD: "), verdict
    assert verdict.endswith("; all decoded."), verdict
