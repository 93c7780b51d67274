# SPDX-License-Identifier: GPL-2.0-or-later
"""README and the pages of docs: short lines and sentences, plain words, links that lead somewhere."""
import pathlib
import re

import pytest

TOP = pathlib.Path(__file__).resolve().parents[2]
README = (TOP / "README.md").read_text()
GENERATED = ("api.md", "columns.md", "filters.md", "BENCH.md")
PAGES = [path.relative_to(TOP) for path in (TOP / "README.md", TOP / "CONTRIBUTING.md", *sorted((TOP / "docs").glob("*.md")))
         if path.name != "BENCH.md"]

# Lines that no reader has to scroll, sentences that nobody has to read twice.
MAX_COLUMNS, MAX_CELL, MAX_WORDS, MAX_MEAN = 100, 120, 25, 20
VAGUE = re.compile(r"\b(that it is about|of which|what is said|as far as|is told|are told|comes? again|came again|thereof|"
                   r"therein|reserved count|stood still|ordinary number|cut short|tells? of)\b", re.I)


def lines_of(page):
    """The lines of a page that are no code and no picture."""
    text = re.sub(r"```.*?```", "", (TOP / page).read_text(), flags=re.S)
    return [line for line in text.splitlines() if not line.startswith(("    ", "!["))]


def test_readme_is_short_and_in_this_order():
    lines = lines_of("README.md")
    assert len(lines) <= 150 and len(" ".join(lines).split()) <= 900
    titles = re.findall(r"^## (.*)", README, re.M)
    assert titles == ["Install", "A first result", "A gate for CI", "Live", "Compare", "Several controllers", "Filters",
                      "Nothing is decoded?", "More", "Tests"]
    links = re.findall(r"\]\(([^)]*)\)", README)
    assert len(links) == len(set(links))


def test_words_in_all():
    """What a person reads; the pages that programs write are looked up."""
    docs = [path for path in (TOP / "docs").glob("*.md") if path.name not in GENERATED]
    for paths, limit in (docs, 18_000), ([TOP / "CHANGELOG.md"], 1_500), ([TOP / "CONTRIBUTING.md"], 1_200):
        assert sum(len(path.read_text().split()) for path in paths) <= limit, paths


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_lengths(page):
    lines = lines_of(page)
    assert [line for line in lines if len(line) > MAX_COLUMNS and not line.startswith("|")] == []
    cells = [cell.strip() for line in lines if line.startswith("|") for cell in re.split(r"(?<!\\)\|", line)]
    assert [cell for cell in cells if len(cell) > MAX_CELL] == []
    prose = " ".join(line for line in lines if not re.match(r"[|#<]|- |\d+\. ", line))
    lengths = {one: len(one.split()) for one in re.split(r"(?<=[.!?:])\s+", prose)}
    assert [one for one, length in lengths.items() if length > MAX_WORDS] == []
    assert sum(lengths.values()) <= MAX_MEAN * len(lengths)


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_words(page):
    assert [(found[0], line) for line in lines_of(page) if (found := VAGUE.search(line))] == []


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_links(page):
    text = (TOP / page).read_text()
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", text):
        path = (TOP / page).parent / target if target else TOP / page
        assert path.exists(), target
        titles = [re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-")
                  for title in re.findall(r"^#+ (.*)", path.read_text(), re.M)] if anchor else []
        assert not anchor or anchor in titles, anchor


def test_the_page_of_the_captures_names_each():
    """A row in test_captures/README.md for each capture and each folder."""
    top = TOP / "test_captures"
    named = re.findall(r"(?m)^\| `([^`]+)` \|", (top / "README.md").read_text())
    folders = {f"{path.name}/" for path in top.iterdir() if path.is_dir() and path.name != "__pycache__"}
    captures = {path.stem for name in ("can", "serial", "candump", "own_messages", "fuzz") for path in (top / name).iterdir()}
    assert len(captures) > 60 and len(named) == len(set(named))
    assert set(named) == captures | folders, f"rows of test_captures/README.md: {set(named) ^ (captures | folders)}"
