#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""make regenerate: write all that follows from the rows of the code and of the catalogue, and print what changed.

New lines of tests/published.txt, the generated pages, the picture of CONTRIBUTING.md, the samples behind `<!-- run -->` in the
pages, and what the captures show.  With --without-tables, less the pages that need the Python package.

A home of its own: an installed plugin, profile or catalogue has no say.
"""
import difflib
import os
import pathlib
import re
import subprocess
import sys
import tempfile

TOP = pathlib.Path(__file__).resolve().parents[1]
SAMPLE = re.compile(r"(<!-- run(?: \d+)? -->\n    \$ (.*)\n)((?:    .*\n)+)")
PRINTED = {"tools/columns_page.py": "docs/columns.md", "tools/api_page.py": "docs/api.md"}
WRITERS = [["tests/e2e/published.py", "--add"], ["tools/filters_page.py"], ["tools/module_map.py", "--write"], ["test_captures/expected.py"], ["tests/e2e/test_messages.py"]]


def texts():
    """The text of each file that may change."""
    paths = [TOP / "README.md", TOP / "CONTRIBUTING.md", *TOP.glob("docs/*.md"), *TOP.glob("test_captures/**/*.expected"),
             TOP / "tests/published.txt"]
    return {path.relative_to(TOP).as_posix(): path.read_text(encoding="utf-8") for path in paths}


def run(*command, **options):
    return subprocess.run(command, cwd=TOP, check=True, stdout=subprocess.PIPE, text=True, encoding="utf-8", **options).stdout


def sample(match):
    """The command of a page with what it prints now, where the plugin is installed."""
    command = f'tshark() {{ command tshark -X lua_script:yapp.lua "$@"; }}; {match[2].replace(" -X lua_script:yapp.lua", "")}'
    done = subprocess.run(["bash", "-c", command], cwd=TOP, check=False, capture_output=True, text=True, encoding="utf-8")
    return match[1] + "".join(f"    {line.rstrip()}\n" for line in done.stdout.splitlines())


def write_all():
    for command in WRITERS:
        run(sys.executable, *command)
    for command, page in {} if "--without-tables" in sys.argv else PRINTED.items():
        text = run(sys.executable, command)
        (TOP / page).write_text(text, encoding="utf-8")
    for page in [TOP / "README.md", *TOP.glob("docs/*.md")]:
        page.write_text(SAMPLE.sub(sample, page.read_text(encoding="utf-8")), encoding="utf-8")


def main():
    before = texts()
    with tempfile.TemporaryDirectory(prefix="yapp-home-") as home:
        for name in [name for name in os.environ if name.startswith(("XDG_", "WIRESHARK_", "YAPP_"))]:
            del os.environ[name]
        os.environ.update(HOME=home, LC_ALL="C.UTF-8", TZ="UTC")
        write_all()
    after = texts()
    changed = [name for name in after if after[name] != before.get(name)]
    for name in changed:
        lines = list(difflib.ndiff(before.get(name, "").splitlines(), after[name].splitlines()))
        print(f"{name}: {sum(line.startswith('+ ') for line in lines)} lines new, {sum(line.startswith('- ') for line in lines)} gone")
    print(f"regenerate: {len(changed)} of {len(after)} files changed" + (": read git diff" if changed else ""))


if __name__ == "__main__":
    main()
