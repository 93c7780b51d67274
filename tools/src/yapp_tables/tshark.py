# SPDX-License-Identifier: GPL-2.0-or-later
"""tshark and the plugin: one run over one capture, its statistics written to a folder, its refusals as sentences."""

import errno
import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from threading import Event
from typing import Any
from weakref import WeakSet

from .errors import CaptureError, SetupError, YappError, count_of
from .install import find_tshark
from .scratch import scratch

INSTALL_TSHARK = "install Wireshark (Debian, Ubuntu: apt-get install tshark) or name the program with --tshark PATH"
INSTALL_PLUGIN = "install it (yapp-tables install) or name it with --plugin PATH/yapp.lua"
# An empty capture: a pcap header (SocketCAN, 64 KB packets) and no packet.
EMPTY_PCAP = bytes.fromhex("d4c3b2a1 0200 0400 00000000 00000000 00000100 e3000000")
# Memory in few large pieces, none of which goes back before the end: of a flight of 240 s, tshark takes 15 % less CPU
# with glibc 2.36. Other systems ignore it.
LARGE_PIECES = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
LARGE_PIECES |= {"MALLOC_TOP_PAD_": str(64 << 20), "MALLOC_TRIM_THRESHOLD_": str(1 << 30)}
PLUGIN_SAYS = "yapp: "
# Nothing is missing then: the second message is left out.
COPIES = re.compile(r"^\d+ messages? (was|were) recorded twice")
# Exit codes: a rule does not hold, a statistic leaves something out.
OF_STATISTICS = (20, 21)
RUNNING: WeakSet[subprocess.Popen[str]] = WeakSet()
STOPPED = Event()

Record = dict[str, Any]


@dataclass(frozen=True)
class Export:
    """What one run left behind: `<message>.csv` and `fields.json` in folder, and the lines of the other statistics.

    partial: tshark's reason where the capture is damaged; lacks: sentences on what the plugin leaves out: messages that
    were not decoded, unreliable events, a preference that it cannot read; notes: what else it says, of copies.
    """

    folder: Path
    fields: Record
    records: dict[str, list[Record]] = field(default_factory=dict)
    partial: str | None = None
    lacks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Tshark:
    """How tshark is called: everything that all captures of one command have in common.

    tshark: a path or a name in PATH, None for the usual places; plugin: yapp.lua where it is not installed;
    options: preferences, ["yapp.motor_ids:0x210,0x211"]; filter: a display filter, only these messages are taken;
    profile: a profile of Wireshark's; bitrate: of the CAN buses, for a table of these, which takes longer.
    """

    tshark: str | os.PathLike[str] | None = None
    plugin: str | os.PathLike[str] | None = None
    options: Sequence[str] = ()
    filter: str | None = None
    profile: str | None = None
    bitrate: int | None = None

    def export(self, capture: Path, folder: Path, more: Sequence[str] = ("summary,brief,json",)) -> Export:
        """Write a capture's messages to folder, which is made. more: statistics besides, a summary among them.

        Returns an Export. Raises SetupError, CaptureError, OSError on a full disk; YappError where another try may do.
        """
        folder.mkdir(parents=True)
        # Relative to tshark's own folder: a comma in a path would end the option.
        buses = [f"buses,bitrate={self.bitrate},json"] if self.bitrate is not None else []
        done = self._ask(capture, ["csv,csv", "events,json", *buses, *more], folder)
        if os.strerror(errno.ENOSPC) in done.stderr:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
        described = folder / "csv/fields.json"
        partial = self._refusal(capture, done, written=described.is_file())
        fields: Record = json.loads(described.read_text(encoding="utf-8"))
        lines = _said(done)
        notes = tuple(line for line in lines if COPIES.search(line))
        lacks = tuple(line for line in lines if line not in notes)
        records: dict[str, list[Record]] = {name: [] for name in ("check", "events", "buses", "summary")}
        keys = {"rule": "check", "kind": "events", "yapp": "buses"}  # of the others' lines
        for record in _json_lines(done.stdout):
            records[next((name for key, name in keys.items() if key in record), "summary")].append(record)
        return Export(described.parent, fields, records, partial, lacks, notes)

    def ask(self, capture: Path, statistics: Sequence[str], rules: str = "") -> tuple[list[Record], list[str], str]:
        """Return the JSON lines of statistics, what the plugin says they leave out, and the text of others.

        rules: what stands in the file `rules`. Of a capture that can be read in part, the answer is about that part:
        the export says so. Raises as export does, and SetupError where a rule has errors.
        """
        with scratch() as folder:
            (folder / "rules").write_text(rules, encoding="utf-8")
            done = self._ask(capture, statistics, folder)
        self._refusal(capture, done, written=True)
        said = _said(done)
        if wrong := [found[1][:200] for line in said if (found := re.match(r"check: (?:rules=)?rules:(.*)", line))]:
            raise SetupError("\n  line ".join([f"{count_of(len(wrong), 'error')} in the file of rules:", *wrong[:5]]))
        text = "".join(line for line in done.stdout.splitlines(keepends=True) if not line.startswith("{"))
        return list(_json_lines(done.stdout)), said, text

    def fields(self) -> Record:
        """Return fields.json of this plugin with these options. Asked with an empty capture: it proves both."""
        with scratch() as folder:
            empty = Path(folder, "empty.pcap")
            empty.write_bytes(EMPTY_PCAP)
            try:
                return self.export(empty, Path(folder, "export")).fields
            except CaptureError as error:
                # Nothing is wrong with this capture: it is the plugin that refuses, a filter for example.
                raise SetupError(str(error).removeprefix(f"{empty}: ")) from error

    def run(self, capture: Path, options: Sequence[str]) -> str:
        """Return what tshark prints of a capture with these options."""
        return _run([*self._reading(capture), *options]).stdout

    def _reading(self, capture: Path) -> list[str]:
        command = [self.find(), "-r", str(capture.resolve())]
        if self.plugin is not None:
            path = Path(self.plugin)
            script = path / "yapp.lua" if path.is_dir() else path
            if not script.is_file():
                raise SetupError(f"no plugin at {path}: --plugin names the plugin's yapp.lua")
            command += ["-X", f"lua_script:{script.resolve()}"]
        command += ["-C", self.profile] if self.profile else []
        return command + [word for option in self.options for word in ("-o", option)]

    def _ask(self, capture: Path, wanted: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
        check_file(capture)
        narrowed = f",filter={self.filter}" if self.filter else ""
        statistics = [word for what in wanted for word in ("-z", f"yapp,{what}{narrowed}")]
        return _run([*self._reading(capture), "-q", *statistics], folder)

    def find(self) -> str:
        """Return the path of the program. Raises SetupError."""
        found = shutil.which(self.tshark) if self.tshark else find_tshark()
        if not found:
            what = f"{self.tshark} is no program that can be run" if self.tshark else "tshark was not found"
            raise SetupError(f"{what}: {INSTALL_TSHARK}")
        return os.path.abspath(found)

    def _refusal(self, capture: Path, done: subprocess.CompletedProcess[str], written: bool) -> str | None:
        """None where all went well, the reason where part of the capture was read; raises where nothing was."""
        said = _complaint(done.stderr)
        if "-z argument" in done.stderr or "-z option" in done.stderr:
            raise SetupError(
                f"tshark has no YAPP plugin that knows -z yapp,csv: {INSTALL_PLUGIN}; as root, Wireshark 4.4 and later "
                "ignore Lua plugins without a word"
            )
        if done.returncode < 0:
            raise YappError(f"{capture}: tshark was ended by signal {-done.returncode}")
        if done.returncode == 0:
            if not written:
                raise SetupError(f"the plugin wrote no fields.json{said and ': ' + said}: {INSTALL_PLUGIN}")
            return None
        if written and done.returncode in OF_STATISTICS:
            # Instead of tshark's own code: what it says of the file tells.
            lines = (line for line in done.stderr.splitlines() if f'"{capture.resolve()}"' in line)
            return _complaint("\n".join(lines)) or None
        if written and done.returncode > 1:
            return said or f"tshark ended with {done.returncode}"
        if "reference" in said or "-o flag" in said:
            raise SetupError(said)
        raise CaptureError(f"{capture}: {said or f'tshark ended with {done.returncode}'}")


def _run(command: list[str], folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    if STOPPED.is_set():
        raise SetupError("stopped; the same command does the rest")
    try:
        process = subprocess.Popen(
            command, cwd=folder, env=LARGE_PIECES | os.environ, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, encoding="utf-8", errors="replace",
        )  # fmt: skip
    except OSError as error:
        raise SetupError(f"{command[0]} cannot be run ({error.strerror}): {INSTALL_TSHARK}") from error
    with process:
        RUNNING.add(process)
        said = process.communicate()
    return subprocess.CompletedProcess(command, process.returncode, *said)


def stop() -> None:
    """End each tshark that runs, of all threads, and let none begin."""
    STOPPED.set()
    for process in list(RUNNING):
        process.kill()


def check_file(capture: Path) -> None:
    """Raise CaptureError where there is no file that can be read."""
    if not capture.is_file():
        raise CaptureError(f"{capture}: no such file")
    if not os.access(capture, os.R_OK):
        raise CaptureError(f"{capture} cannot be read: permission denied")


def _complaint(stderr: str) -> str:
    """What tshark said, without what it says every time as root, on one line."""
    lines = [line.strip() for line in stderr.splitlines()]
    return " ".join(line.removeprefix("tshark: ") for line in lines if line and not line.startswith("Running as user"))


def _said(done: subprocess.CompletedProcess[str]) -> list[str]:
    """Return what the plugin says: what it leaves out, and copies."""
    own = (line.removeprefix(PLUGIN_SAYS) for line in done.stderr.splitlines() if line.startswith(PLUGIN_SAYS))
    return list(dict.fromkeys(own))


def _json_lines(stdout: str) -> Iterator[Record]:
    """Yield what statistics printed; numbers with a point stay exact."""
    return (json.loads(line, parse_float=Decimal) for line in stdout.splitlines() if line.startswith("{"))
