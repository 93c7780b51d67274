#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Install YAPP for Wireshark for the user who runs it: the plugin, the live ports (extcap) and the profile YAPP.

    install.py                      install, or bring an installation up to date, and check it
    install.py check                only check: what is there, and what is wrong with it
    install.py uninstall            remove what was installed and is unchanged
    install.py uninstall --purge    remove all of it, what you changed and what Wireshark keeps in the profile included

`yapp-tables install`, `check` and `uninstall` are this program too.

What you changed is never lost.  An upgrade leaves a changed catalogue (taurus_fields.lua) or profile file as it is and
puts the new version beside it as NAME.new; changed code makes way for the new and stays beside it as NAME.edited.
Uninstalling keeps both.  What was installed is known by the hashes in installed.json, in the plugin's folder; of the
profile's files, which Wireshark writes anew when it likes, by what is in them.

Python 3.7 or later, nothing but its standard library; Linux, macOS and Windows.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

# Files of earlier versions, by the first 8 digits of their SHA-256: those of 1.0.0, which left no list behind; of the
# profile of 2.0.0, by what is in them.
EARLIER = """
02a131cf 02b7dbae 02ed48e0 039a1b24 04e74981 06ab1926 09929df2 0d003beb 0e80646d 11616164 1255330f 184c32d4 196fd349
21560bc3 250675a7 2639de4b 26b978a4 295ddb25 2a9224e2 2c94f9c9 2d178ded 2fcf9b24 343c468e 364e11ed 37bf23e6 3a334311
3de11da8 3e216626 43e85a9d 4431f416 45deb55b 4a66655c 51369fb6 52950e86 52ac04db 55bf60ec 58767335 5af7973a 6256b6c5
6270ef85 63fd604a 668938b8 67b4b839 680d35c8 6ebaef24 71dc8b1c 778cc0be 79fa0c75 7bbbe7a0 7d1f6780 7deb33fd 800f5f1f
80494c43 81efc0e1 836c088c 8396b192 848baec8 866b3858 88a9fd9b 8c6748b7 8fec3e4f 912d9b47 95b79550 95d02745 966a6aae
976e7e7e 98c7d4c6 9a407302 9cf1d208 9e777c92 a073820e a388c88c a68e530e a955ab6e a9e35b5b aa139401 aefc6f44 b0fb5eaa
b398c75b b8cf2eab b9c2f8bd bce38c2f bec73a66 c36bb9e5 c453260c c4605cc6 c6b72acc cc5fc6ad cd62550e d4c37483 d6dd83aa
d84b8a74 d93b479b dcd8e03f dda48212 ddf59efc df805704 e9c81f20 ef8f3129 f1faf856 f4d52614 f5c91c6c fc6a40e1 fd1335a4
ff395b6e
2d330114 da941647 f1bf3b8b 2e49ab76 0cae8e72 55e79b49
"""
OLDEST = (4, 0)  # Wireshark
SETTLED = (4, 4)  # from here on root runs no Lua plugins
TRIED = ("5.2", "5.4", "5.5")  # Lua
TO_EDIT = ("taurus_fields.lua",)  # and everything in the profile
# Of the profile: tables, settings, what Wireshark keeps for itself, and settings that it makes itself.
TABLES = ("io_graphs", "plots", "dfilter_buttons")
SETTINGS = ("preferences", "profile_settings", "extcap.cfg")
WIRESHARKS = ("recent", "extcap.cfg")
ITS_SETTINGS = ("gui.qt.font_name",)


class Problem(Exception):  # noqa: N818
    """What stands in the way, as a sentence for the user."""


def say(what: str, text: object) -> None:
    """Print a line of what was done or found."""
    print(f"{what:<9} {text}")


# Wireshark ------------------------------------------------------------------------------------------------------------


def find_tshark() -> str | None:
    """Where tshark is."""
    programs = [os.environ.get(name, "?") for name in ("ProgramW6432", "ProgramFiles", "ProgramFiles(x86)")]
    places = [os.path.join(folder, "Wireshark", "tshark.exe") for folder in programs]
    places.append("/Applications/Wireshark.app/Contents/MacOS/tshark")
    return shutil.which("tshark") or next((path for path in places if os.path.exists(path)), None)


def ask(*command: str) -> tuple[str, str]:
    """What a program prints: stdout and stderr."""
    pipe = subprocess.PIPE
    done = subprocess.run(command, stdout=pipe, stderr=pipe, stdin=subprocess.DEVNULL, check=False, timeout=120)
    return done.stdout.decode("utf-8", "replace"), done.stderr.decode("utf-8", "replace")


class Wireshark:
    """The installed Wireshark, as far as it is there.

    tshark: the program, version: (4, 0, 17), lua: "5.2.4", None where it was built without; the personal folders
    config, plugins and extcap; plugin_folders: all that Lua plugins are loaded from.
    """

    def __init__(self) -> None:
        """Ask tshark, where there is one."""
        self.tshark = find_tshark()
        self.version: tuple[int, ...] = ()
        self.lua: str | None = None
        named: dict[str, Path] = {}
        if self.tshark:
            about = ask(self.tshark, "--version")[0]
            number = re.search(r"(\d+)\.(\d+)\.(\d+)", about)
            if not number:
                raise Problem(f"{self.tshark} does not say its version: does it start?")
            self.version = tuple(int(part) for part in number.groups())
            lua = re.search(r"(?:with\s+|\+)Lua(?:\s+(\d+\.\d+(?:\.\d+)?))?", about)
            self.lua = lua and (lua[1] or "of a version that it does not say")
            lines = (line.partition(":") for line in ask(self.tshark, "-G", "folders")[0].splitlines())
            named = {name.strip(): Path(path.strip()) for name, _, path in lines if path.strip()}
        self.config = named.get("Personal configuration") or self.usual_config()
        local = self.config if os.name == "nt" else Path.home() / ".local/lib/wireshark"
        self.plugins = named.get("Personal Lua Plugins") or local / "plugins"
        # 4.0 does not name it, and has it in the configuration folder.
        self.extcap = named.get("Personal Extcap path") or (self.config if self.tshark else local) / "extcap"
        others = (named.get("Global Lua Plugins"), self.plugins, self.config / "plugins")
        self.plugin_folders = [folder for folder in others if folder]

    @staticmethod
    def usual_config() -> Path:
        """Where the configuration is when there is no tshark to ask."""
        if os.name == "nt":
            return Path(os.environ["APPDATA"]) / "Wireshark"
        return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "wireshark"

    @property
    def name(self) -> str:
        """Such as Wireshark 4.0.17."""
        return "Wireshark " + ".".join(map(str, self.version))

    @property
    def target(self) -> Path:
        """The plugin's folder."""
        return self.plugins / "yapp"

    @property
    def profile(self) -> Path:
        """The profile's folder."""
        return self.config / "profiles" / "YAPP"

    @property
    def note(self) -> Path:
        """The file with one line, where yapp-tables is: the plugin's menu starts it."""
        return self.config / "yapp_tables.path"


# The files ------------------------------------------------------------------------------------------------------------


def source_folder() -> Path:
    """The folder that has the plugin: in the package, beside this program in the zip, in the repository the topmost."""
    here = Path(__file__).resolve().parent
    for folder in (here / "plugin", here, *list(here.parents)[2:3]):
        if (folder / "yapp.lua").is_file() and (folder / "taurus_fields.lua").is_file():
            return folder
    raise Problem(f"{here} has no yapp.lua: unpack the whole zip, and run install.py where it lies")


def plugin_version(path: Path) -> str | None:
    """The version that a yapp.lua says."""
    found = re.search(r'^local VERSION = "(.*)"', path.read_text(encoding="utf-8", errors="replace"), re.MULTILINE)
    return found[1] if found else None


def own_program() -> str:
    """Where the command yapp-tables of this Python is."""
    return shutil.which("yapp-tables", path=sysconfig.get_path("scripts")) or os.path.abspath(sys.argv[0])


def wanted_files(source: Path, wireshark: Wireshark, program: str | None) -> dict[Path, bytes]:
    """What belongs where; program: yapp-tables, when that installs."""
    files = {wireshark.target / name: (source / name).read_bytes() for name in ("yapp.lua", "taurus_fields.lua")}
    if (source / "yapp").is_dir():  # the repository: elsewhere they are in one file already
        sys.path.insert(0, str(source / "tools"))
        files[wireshark.target / "yapp.lua"] = importlib.import_module("bundle").bundle(source).encode()
    places = ((source / "extcap", wireshark.extcap, "*.py"), (source / "profiles/YAPP", wireshark.profile, "*"))
    for folder, to, pattern in places:
        for path in sorted(folder.glob(pattern)):
            files[to / path.name] = path.read_bytes()
            if os.name == "nt" and path.suffix == ".py":  # Wireshark on Windows starts no scripts
                start = f'@"{sys.executable}" "%~dp0{path.name}" %*\r\n'
                files[to / (path.stem + ".bat")] = start.encode(sys.getfilesystemencoding())
    if program:
        files[wireshark.note] = f"{program}\n".encode()
    elif wireshark.note.is_file():
        files[wireshark.note] = wireshark.note.read_bytes()
    return files


def cell(text: str) -> str:
    """What a cell of one of Wireshark's tables says, in one of the ways to write it."""
    text = re.sub(rb"\\x([0-9a-fA-F]{2})", lambda found: bytes([int(found[1], 16)]), text.encode()).decode(
        "utf-8", "replace"
    )
    if re.fullmatch(r"#[0-9A-Fa-f]{6}", text):
        return text.lower()
    if re.fullmatch(r"-?\d+(\.\d+)?", text):
        return repr(float(text))
    return {"Enabled": "TRUE", "Disabled": "FALSE"}.get(text, text)


def table(lines: Sequence[str]) -> Iterator[str]:
    """The rows of a table; a later version's further columns count where they are not at their default."""
    for row in csv.reader(lines):
        cells = [cell(text) for text in row]
        while cells and cells[-1] in ("", "FALSE"):
            cells.pop()
        yield "\t".join(cells)


def settings(lines: Sequence[str]) -> list[str]:
    """Each setting with its value, in order of the names; those that Wireshark makes itself are none."""
    entries = re.split(r"\n(?!\s)", "\n".join(lines))
    pairs = (entry.partition(":") for entry in entries)
    return sorted(
        f"{key}:{' '.join(value.split())}" for key, _, value in pairs if value.strip() and key not in ITS_SETTINGS
    )


def meaning(name: str, content: bytes) -> str:
    """What is in a file of the profile, however Wireshark writes it."""
    text = content.decode("utf-8", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if name in TABLES:
        return "\n".join(table(lines))
    return "\n".join(settings(lines) if name in SETTINGS else lines)


def digest(data: bytes) -> str:
    """SHA-256."""
    return hashlib.sha256(data).hexdigest()


class Installation:
    """What is installed, by the list that an installation leaves behind.

    hashes: { path: what was installed there, or would have been had the user not changed it, as fingerprint() has it };
    folders: those that were made for it.
    """

    def __init__(self, wireshark: Wireshark) -> None:
        """Read the list, where there is one."""
        self.wireshark = wireshark
        self.target = wireshark.target
        self.list = self.target / "installed.json"
        self.hashes: dict[Path, str] = {}
        self.folders: list[Path] = []
        self.said: set[Path] = set()
        if self.list.is_file():
            try:
                content = json.loads(self.list.read_text(encoding="utf-8"))
                self.hashes = {Path(path): value for path, value in content["files"].items()}
                self.folders = [Path(path) for path in content["folders"]]
            except (ValueError, KeyError, AttributeError) as problem:
                raise Problem(f"{self.list} is damaged; remove it, then every file counts as changed") from problem
        self.contents = set(self.hashes.values())

    def say(self, what: str, path: Path, why: str) -> None:
        """Print what becomes of a file that is not as it was installed."""
        say(what, f"{path}: {why}")
        self.said.add(path)

    def fingerprint(self, path: Path, content: bytes) -> str:
        """What a file is known by: its bytes; of the profile's, which Wireshark rewrites, what is in it."""
        if path.parent != self.wireshark.profile:
            return digest(content)
        return digest(meaning(path.stem if path.suffix == ".new" else path.name, content).encode())

    def is_ours(self, path: Path) -> bool:
        """Whether the file is as some installation left it, or as Wireshark wrote that anew."""
        if path.is_symlink() or not path.is_file():
            return False
        content = path.read_bytes()
        known = {digest(content), self.fingerprint(path, content)}
        return not known.isdisjoint(self.contents) or any(each[:8] in EARLIER for each in known)

    def is_module(self, path: Path) -> bool:
        """Whether it is one of the modules of 1.0 and 2.0, by its name: today they are all in yapp.lua."""
        return path.parent == self.target / "yapp" and path.match("yapp_*.lua")

    def candidates(self) -> set[Path]:
        """Paths of the earlier installation; those that may be, where it left no list."""
        return set(self.hashes) or {*self.target.glob("*.lua"), *self.target.glob("yapp/*.lua")}

    def write(self, path: Path, content: bytes) -> None:
        """Write a file of ours, whole or not at all."""
        missing = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        self.folders += [folder for folder in missing if folder not in self.folders]
        new = path.with_name(path.name + ".part")
        new.write_bytes(content)
        new.chmod(0o755 if path.parent == self.wireshark.extcap else 0o644)
        os.replace(str(new), str(path))
        self.hashes[path] = self.fingerprint(path, content)

    def put(self, path: Path, content: bytes) -> None:
        """Bring one file up to date; what the user changed stays, in its place or beside it."""
        before, now = self.hashes.get(path), self.fingerprint(path, content)
        beside = path.with_name(path.name + ".new")
        there = os.path.lexists(str(path))
        if (
            not there
            or self.is_ours(path)
            or (path.is_file() and not path.is_symlink() and path.read_bytes() == content)
        ):
            self.write(path, content)
            self.remove(beside)
        elif path.name not in TO_EDIT and path.parent != self.wireshark.profile:
            self.say("replaced", path, f"it was changed; your version is kept beside it, {self.set_aside(path).name}")
            self.write(path, content)
        elif before == now:
            self.say("kept", path, "you changed it")
        else:
            self.hashes[path] = now
            self.say("kept", path, f"you changed it; this version's is beside it, {beside.name}")
            if os.path.lexists(str(beside)) and not self.is_ours(beside):
                self.set_aside(beside)
            self.write(beside, content)

    @staticmethod
    def set_aside(path: Path) -> Path:
        """Rename a file to a name that is free and that Wireshark does not run; returns the new path."""
        count, aside = 1, path.with_name(path.name + ".edited")
        while os.path.lexists(str(aside)):
            count += 1
            aside = path.with_name(f"{path.name}.edited{count}")
        path.rename(aside)
        if not aside.is_symlink():
            aside.chmod(0o644)
        return aside

    def remove(self, path: Path) -> None:
        """Remove a file that is as it was installed, and say so of one that is not."""
        if self.is_ours(path):
            path.unlink()
        elif os.path.lexists(str(path)) and self.is_module(path):
            self.say("kept", self.set_aside(path), f"you changed it; Wireshark would run it as {path.name}")
        elif path in self.hashes and os.path.lexists(str(path)) and not is_wiresharks(path):
            self.say("kept", path, "you changed it")
        self.hashes.pop(path, None)

    def install(self, files: dict[Path, bytes]) -> None:
        """Put the files in their places, and take those of an earlier version away."""
        for path in sorted(self.candidates() - set(files)):
            if path.suffix != ".new" or path.with_suffix("") not in files:
                self.remove(path)  # of an earlier version, or of another Wireshark's folder
        for path, content in files.items():
            # Where windows and columns were last Wireshark writes at every exit: ours is for the first time only.
            if not (path.parent == self.wireshark.profile and is_wiresharks(path)):
                self.put(path, content)
        self.remove_folders([self.target / "yapp", *self.folders])
        made = [str(folder) for folder in self.folders if folder.is_dir()]
        listed = {"files": {str(path): value for path, value in self.hashes.items()}, "folders": made}
        self.list.write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")

    def uninstall(self) -> None:
        """Remove what is as it was installed, and what Wireshark keeps in a profile that nothing else is in."""
        own = [self.target / "yapp", self.target, self.wireshark.profile]
        for path in sorted(self.candidates()):
            self.remove(path)
        if self.list.exists():
            self.list.unlink()
        left = list(self.wireshark.profile.glob("*"))
        if all(is_wiresharks(path) for path in left):
            for path in left:
                path.unlink()
        self.remove_folders([*own, *self.folders])
        for path in sorted(path for folder in own for path in folder.glob("*")):
            if path not in own and path not in self.said:
                self.say("kept", path, "it is not as it was installed")

    def outside(self) -> list[Path]:
        """What lies in folders that are not ours."""
        own = (self.target, self.wireshark.profile)
        listed = [path for path in self.hashes if not any(folder in path.parents for folder in own)]
        found = [*self.wireshark.extcap.glob("yapp_extcap.*"), *self.wireshark.config.glob("yapp_tables.path*")]
        return sorted({*listed, *found})

    def purge(self) -> None:
        """Remove all of it, whoever wrote it."""
        for path in self.outside():
            if os.path.lexists(str(path)):
                path.unlink()
        for folder in (self.wireshark.profile, self.target):
            if folder.is_symlink():
                folder.unlink()
            elif folder.is_dir():
                shutil.rmtree(str(folder))
        self.remove_folders(self.folders)

    @staticmethod
    def remove_folders(folders: Iterable[Path]) -> None:
        """Remove those that are empty, deepest first."""
        for folder in sorted(set(folders), key=lambda folder: -len(folder.parts)):
            if folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir()):
                folder.rmdir()


def is_wiresharks(path: Path) -> bool:
    """Whether Wireshark alone wrote this file of the profile: where windows were, or settings that are all unset."""
    if path.name not in WIRESHARKS or path.is_symlink() or not path.is_file():
        return False
    return path.name == "recent" or not meaning(path.name, path.read_bytes())


# What is wrong --------------------------------------------------------------------------------------------------------


def real(path: object) -> str:
    """The path without links, in the one way to write it."""
    return os.path.normcase(os.path.realpath(str(path)))


def is_root() -> bool:
    """Whether root runs this."""
    return hasattr(os, "geteuid") and os.geteuid() == 0


def copies(wireshark: Wireshark) -> list[Path]:
    """The folders with a yapp.lua from which Wireshark may load it."""
    found = {real(path): path.parent for folder in wireshark.plugin_folders for path in folder.glob("**/yapp.lua")}
    return list(found.values())


def refuse_to_install(source: Path, wireshark: Wireshark) -> None:
    """Raise where an installation would do harm."""
    if os.environ.get("SUDO_USER") and is_root():
        raise Problem("run it without sudo: everything goes into the home of the user who runs Wireshark")
    for folder in wireshark.plugin_folders:
        if real(source) == real(folder) or real(source).startswith(real(folder) + os.sep):
            raise Problem(
                f"{source} is in Wireshark's plugin folder, from which it is loaded as it is: move it elsewhere "
                "(your own changes with it), and run this again there"
            )
    for folder in (wireshark.target, wireshark.target / "yapp", wireshark.profile):
        if folder.is_symlink():
            raise Problem(f"{folder} is a link to {folder.resolve()}: remove the link first")


def problems(source: Path, wireshark: Wireshark) -> Iterator[str]:
    """Say what there is, and give the sentences that say what is wrong with it."""
    entry = wireshark.target / "yapp.lua"
    for folder in copies(wireshark):
        if real(folder) != real(wireshark.target):
            yield f"another copy of the plugin is in {folder}: Wireshark loads only one; remove one of them"
    if not entry.is_file():
        yield f"nothing is installed in {wireshark.target}"
    else:
        installed, own = plugin_version(entry), plugin_version(source / "yapp.lua")
        if installed != own:
            yield f"{entry} is version {installed or 'unknown'}, this is {own}: install it again"
    yield from sandboxes(wireshark)
    if not wireshark.tshark:
        print("tshark was not found, so whether Wireshark loads the plugin was not checked.")
    else:
        say("wireshark", f"{wireshark.name}, Lua {wireshark.lua or 'none'}: {wireshark.tshark}")
        yield from unfit(wireshark)
        if entry.is_file() and wireshark.lua and wireshark.version >= OLDEST:
            yield from loading_problems(wireshark, wireshark.tshark, entry)
    live_ports(wireshark)


def unfit(wireshark: Wireshark) -> Iterator[str]:
    """What no installation helps against."""
    if wireshark.version < OLDEST:
        yield f"{wireshark.name} is too old: {OLDEST[0]}.{OLDEST[1]} or later is needed"
    if not wireshark.lua:
        yield f"{wireshark.tshark} was built without Lua: install Wireshark's official package, or your distribution's"
    elif wireshark.lua[0].isdigit() and not wireshark.lua.startswith(TRIED):
        say("note", f"the plugin was tried with Lua {', '.join(TRIED)}, not with {wireshark.lua}")


def loading_problems(wireshark: Wireshark, tshark: str, entry: Path) -> Iterator[str]:
    """Whether Wireshark loads what is installed."""
    protocols, errors = ask(tshark, "-G", "protocols")
    if re.search(r"\tyapp\s", protocols):
        plugins = ask(tshark, "-G", "plugins")[0]
        loaded = [line.split("\t")[-1].strip() for line in plugins.splitlines() if line.startswith("yapp.lua\t")]
        if loaded and real(loaded[0]) != real(entry):
            yield f"Wireshark loads {loaded[0]} instead of {entry}"
        else:
            say("checked", f"{wireshark.name} loads {entry}")
    elif is_root() and wireshark.version >= SETTLED:
        yield f"as root, {wireshark.name} runs no Lua plugins: install and run it as an ordinary user"
    else:
        said = [line for line in errors.splitlines() if "Lua" in line or "lua" in line]
        yield f"{wireshark.name} does not load {entry}" + "".join(f"\n  {line}" for line in said[:5])


def sandboxes(wireshark: Wireshark) -> Iterator[str]:
    """A Wireshark of Flatpak or Snap: a problem where there is no other one."""
    found = []
    for folder in (Path.home() / ".local/share/flatpak", Path("/var/lib/flatpak")):
        if (folder / "app/org.wireshark.Wireshark").is_dir():
            found.append(("Flatpak", folder))
    programs = [os.path.join(folder, "wireshark") for folder in os.environ.get("PATH", "").split(os.pathsep)]
    programs.append(wireshark.tshark or "")
    found += [("Snap", Path(path)) for path in programs if "/snap/" in path and os.path.exists(path)]
    if not found:
        return
    kind, where = found[0]
    text = (
        f"the Wireshark of {kind} ({where}) sees no plugin folder and cannot capture: use your distribution's package"
    )
    if wireshark.tshark and "/snap/" not in wireshark.tshark:
        say("note", f"{text}, {wireshark.tshark}, which is there too")
    else:
        yield text


def live_python(wireshark: Wireshark) -> str | None:
    """The Python that runs the live ports: on Windows the one that installed, elsewhere the first in PATH."""
    batch = wireshark.extcap / "yapp_extcap.bat"
    if batch.is_file():
        named = re.match(r'@"(.*?)"', batch.read_text(encoding=sys.getfilesystemencoding()))
        return named[1] if named and os.path.exists(named[1]) else None
    return shutil.which("python3")


def live_ports(wireshark: Wireshark) -> None:
    """Say what runs the live ports, and what it has."""
    if not (wireshark.extcap / "yapp_extcap.py").is_file():
        if wireshark.target.is_dir():
            say("note", f"no live ports in {wireshark.extcap}: install it again")
        return
    python = live_python(wireshark)
    if not python:
        say("note", "no python3 in PATH, so there are no live ports: they need Python 3.7 or later")
        return
    look = "import sys, importlib.util as u; print(sys.version.split()[0], *filter(u.find_spec, ('serial', 'can')))"
    version, *found = ask(python, "-c", look)[0].split() or ["(it does not start)"]
    states = [
        f"{'with' if module in found else 'without'} {name}"
        for name, module in (("pyserial", "serial"), ("python-can", "can"))
    ]
    say("python", f"{python} {version} runs the live ports, {', '.join(states)}")
    if len(found) < len(states):
        say("note", f"pyserial is for ports on Windows, python-can for CAN adapters: {python} -m pip install NAME")


# ----------------------------------------------------------------------------------------------------------------------


def install(source: Path, wireshark: Wireshark, program: str | None) -> None:
    """Install, and say where."""
    refuse_to_install(source, wireshark)
    Installation(wireshark).install(wanted_files(source, wireshark, program))
    say("plugin", wireshark.target)
    for name, there in (("extcap", wireshark.extcap), ("profile", wireshark.profile)):
        if there.is_dir():
            say(name, there)


def contents(path: Path) -> list[Path]:
    """What is there: the path, and those in it."""
    return [each for each in (path, *path.rglob("*")) if os.path.lexists(str(each))]


def uninstall(wireshark: Wireshark, purge: bool) -> None:
    """Uninstall, and say what is gone."""
    installation = Installation(wireshark)
    if not (installation.target.exists() or purge):
        print(f"Nothing is installed in {installation.target}")
        return
    there = {path: contents(path) for path in (*installation.outside(), wireshark.profile, installation.target)}
    if purge:
        installation.purge()
    else:
        installation.uninstall()
    for path, before in there.items():
        if contents(path) != before:
            say("removed", f"{path}{', except what is kept' if path.exists() else ''}")
    if installation.said:
        say("note", "uninstall --purge removes what is kept, too")


def run(what: str, purge: bool = False, program: str | None = None) -> int:
    """Do one of install, check and uninstall; program: yapp-tables, for the plugin's menu.  Returns the exit code."""
    found = []
    try:
        wireshark = Wireshark()
        if what == "uninstall":
            uninstall(wireshark, purge)
        else:
            source = source_folder()
            if what == "install":
                install(source, wireshark, program)
            found = list(problems(source, wireshark))
    except (Problem, OSError, subprocess.SubprocessError) as problem:
        found = [str(problem)]
    sys.stdout.flush()  # what is wrong comes last, in a log too
    for text in found:
        print(f"problem   {text}", file=sys.stderr)
    return 1 if found else 0


def main() -> int:
    """Run install.py."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("install", "check", "uninstall"), default="install")
    parser.add_argument("--purge", action="store_true", help="with uninstall: what you changed, too")
    given = parser.parse_args()
    if given.purge and given.what != "uninstall":
        parser.error("--purge goes with uninstall")
    code = run(given.what, given.purge)
    if os.name == "nt" and len(sys.argv) == 1 and sys.stdin.isatty():
        input("Enter closes this window.")  # it was a double click, most likely
    return code


if __name__ == "__main__":
    sys.exit(main())
