# SPDX-License-Identifier: GPL-2.0-or-later
"""The profile's graphs for the controllers of a capture: each row of I/O Graphs and Plots once for each of them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

from .api import read_flight
from .config import Config
from .errors import SetupError
from .install import Wireshark, source_folder
from .palette import LIGHT
from .scratch import write_whole

FILES = ("io_graphs", "plots")
Controller = tuple[str, str]  # its name, and the display filter of its messages


def write_graphs(captures: Sequence[Path], config: Config, out: Path | None) -> tuple[Path, list[str]]:
    """Write both files into a folder, the profile's if none is given. Returns it, and the names. Raises YappError."""
    folder = out or Wireshark().profile
    if not folder.is_dir():
        raise SetupError(f"no folder {folder}: install the profile by yapp-tables install, or name one by --out")
    tshark, _ = config.of(captures[0])
    controllers = found(read_flight(captures[0], tshark).summary.to_pylist())
    if not controllers:
        raise SetupError(f"no Motor Data in {captures[0]}: nothing to draw")
    for name in FILES:
        text = (source_folder() / "profiles/YAPP" / name).read_text(encoding="utf-8")
        write_whole(folder / name, of_each(text, controllers))
    return folder, [name for name, _ in controllers]


def found(rows: Iterable[dict[str, object]]) -> list[Controller]:
    """Return the controllers that sent Motor Data, out of the rows of the summary."""
    controllers = []
    for row in rows:
        if row["message"] != "motor":
            continue
        bus, number, source = row["bus"], row["id"], row["source"]
        if source:
            quoted = str(source).replace("\\", "\\\\").replace('"', '\\"')
            controllers.append((str(source), f'yapp.source == "{quoted}"'))
        else:
            of_bus = f'yapp.bus == "{bus}" && ' if bus else ""
            controllers.append((f"{bus or ''} {number:#x}".strip(), f"{of_bus}yapp.id == {number:#x}"))
    return controllers


def of_each(text: str, controllers: Sequence[Controller]) -> str:
    """Return a table of graphs with each row on Motor Data once for each controller; the others stay."""
    lines, rows = [], []
    for line in text.splitlines():
        if line.startswith("#"):
            lines.append(line)
        else:
            rows.append(next(csv.reader([line])))
    for row in rows:
        title = 2 if row[1].isdigit() else 1  # Plots have a group in front of the title
        if not any(cell.startswith("taurus.motor.") for cell in row):
            lines.append(_line(row))
            continue
        for at, (name, expression) in enumerate(controllers):
            both = " && ".join([expression, *filter(None, row[title + 1 : title + 2])])
            own = [*row[:title], f"{row[title]} {name}", both, LIGHT[at % len(LIGHT)], *row[title + 3 :]]
            lines.append(_line(own))
    return "".join(f"{line}\n" for line in lines)


def _line(row: Sequence[str]) -> str:
    """Return a row as Wireshark writes it: a quote in a cell as \\x22."""
    out = io.StringIO()
    csv.writer(out, quoting=csv.QUOTE_ALL, lineterminator="").writerow([cell.replace('"', "\\x22") for cell in row])
    return out.getvalue()
