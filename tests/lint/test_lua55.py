# SPDX-License-Identifier: GPL-2.0-or-later
"""What Lua 5.5 refuses and 5.2 and 5.4 take: an assignment to the control variable of a loop."""
import pathlib
import re

import pytest

TOP = pathlib.Path(__file__).resolve().parents[2]
SOURCES = [TOP / "yapp.lua", TOP / "taurus_fields.lua", *sorted(TOP.glob("yapp/**/*.lua"))]


def assigned(text):
    """The lines on which a control variable is assigned to: they stand deeper than the line of their loop."""
    loops, found = [], []  # loops: (indent, names)
    for number, line in enumerate(text.split("\n"), 1):
        line = re.sub(r"--.*", "", line).rstrip()
        indent = len(line) - len(line.lstrip())
        if line:
            loops = [loop for loop in loops if indent > loop[0]]
        loop = re.search(r"\bfor (\w+).* do\b(.*)", line)
        if loop and not line.endswith(" end"):
            loops.append((indent, loop[1]))
        rest = loop[2] if loop else line
        for name in [name for _, name in loops] + ([loop[1]] if loop else []):
            if re.search(rf"(?:^\s*|\b(?:then|else|do)\s+)(?:\w+, )*{name}(?:, \w+)* = .*[^,]$", rest) and "local " not in rest:
                found.append(number)
    return found


def test_an_assignment_is_seen():
    assert assigned("for i = 1, 3 do\n  if x then i = 2 end\n  local i = 3\nend\ni = 4\nfor k in y do a, k = 1, 2 end") == [2, 6]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(TOP)))
def test_no_control_variable_is_assigned_to(path):
    assert assigned(path.read_text()) == []
