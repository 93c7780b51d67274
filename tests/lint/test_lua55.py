# SPDX-License-Identifier: GPL-2.0-or-later
"""What Lua 5.5 refuses and 5.2 and 5.4 take: an assignment to the control variable of a loop."""
import pathlib
import re

import pytest

TOP = pathlib.Path(__file__).resolve().parents[2]
SOURCES = [TOP / "yapp.lua", TOP / "taurus_fields.lua", *sorted(TOP.glob("yapp/**/*.lua"))]
TOKEN = re.compile(r"--\[(=*)\[.*?\]\1\]|--[^\n]*|\[(=*)\[.*?\]\2\]|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|"
                   r"\w+|\.\.\.|[=~<>]=|\S", re.S)
OPENS, STATEMENT_ENDS = {"do", "function", "if", "repeat"}, {".", ":", "]", ")"}


def assigned(text):
    """The lines on which a control variable is assigned to."""
    tokens = [one for one in TOKEN.finditer(text) if not one[0].startswith("--")]
    words, blocks, waiting, found = [one[0] for one in tokens], [], None, []
    for at, word in enumerate(words):
        if word == "for":
            waiting = words[at + 1]
        elif word in OPENS:
            blocks.append((word, waiting if word == "do" else None, set()))
            waiting = None if word == "do" else waiting
        elif word in ("end", "until") and blocks:
            blocks.pop()
        elif words[at - 1] == "local" and blocks:
            blocks[-1][2].add(word)
        is_target = words[at + 1:at + 2] == ["="] or words[at + 1:at + 2] == [","] and is_list(words, at)
        if is_target and words[at - 1] not in (".", "local", "{", "for") and is_control(blocks, word) and is_statement(words, at):
            found.append(text.count("\n", 0, tokens[at].start()) + 1)
    return found


def is_list(words, at):
    """Whether names with commas between lead to an assignment."""
    while words[at + 1:at + 2] == [","] and re.match(r"\w+$", words[at + 2]):
        at += 2
    return words[at + 1:at + 2] == ["="]


def is_statement(words, at):
    """Whether no table is open around it: { name = value } assigns to no variable."""
    depth = 0
    for word in reversed(words[:at]):
        if word in "{(":
            depth += 1
        elif word in "})":
            depth -= 1
        elif word in ("then", "do", "else", "function", "end") and depth <= 0:
            return True
        if depth > 0:
            return False
    return True


def is_control(blocks, name):
    for _, control, declared in reversed(blocks):
        if name in declared:
            return False
        if name == control:
            return True
    return False


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(TOP)))
def test_no_control_variable_is_assigned_to(path):
    assert assigned(path.read_text()) == []
