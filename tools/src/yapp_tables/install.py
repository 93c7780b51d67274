#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Install YAPP for Wireshark for the user who runs it: the plugin, the live ports (extcap) and the profile YAPP.

    install.py                      install, or bring an installation up to date, and check it
    install.py check                only check: what is there, and what is wrong with it
    install.py uninstall            remove it
    install.py uninstall --purge    remove it, and what you changed

The installer never loses a file that you edited: it stays beside the new one as NAME.old.
Python 3.7 or later without other packages; Linux, macOS and Windows.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

IS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0
OLDEST, NOT_AS_ROOT = (4, 0), (4, 4)  # Wireshark
WIRESHARKS = ("recent", "preferences")  # of a profile: Wireshark writes them, so ours are for the first time only


class Problem(Exception):  # noqa: N818
    """What stands in the way, as a sentence for the user."""


def say(what: str, text: object) -> None:
    """Print a line of what was done or found."""
    print(f"{what:<9} {text}")


def ask(*command: str) -> tuple[str, str]:
    """Return what a program prints: stdout and stderr."""
    done = subprocess.run(command, stdout=-1, stderr=-1, stdin=subprocess.DEVNULL, check=False, timeout=120)
    return done.stdout.decode("utf-8", "replace"), done.stderr.decode("utf-8", "replace")


def find_tshark() -> str:
    """Return where tshark is, in PATH or where Wireshark's own installers put it; nothing where there is none."""
    programs = os.environ.get("PROGRAMFILES", "/Applications/Wireshark.app")
    usual = (os.path.join(programs, part) for part in ("Wireshark/tshark.exe", "Contents/MacOS/tshark"))
    return shutil.which("tshark") or next(filter(os.path.exists, usual), "")


class Wireshark:
    """The installed Wireshark: tshark and its version (4, 0, 17), lua "5.2.4" or None, and the personal folders."""

    def __init__(self) -> None:
        """Ask tshark, where there is one."""
        self.tshark = find_tshark()
        about = ask(self.tshark, "--version")[0] if self.tshark else ""
        found = re.search(r"(\d+)\.(\d+)\.(\d+)", about)
        self.version = tuple(map(int, found.groups())) if found else ()
        if self.tshark and not self.version:
            raise Problem(f"{self.tshark} does not say its version: does it start?")
        lua = re.search(r"(?:with\s+|\+)Lua(?:\s+(\d+\.\d+(?:\.\d+)?))?", about)
        self.lua = lua and (lua[1] or "of a version that it does not say")
        folders = ask(self.tshark, "-G", "folders")[0] if self.tshark else ""
        named = {name: Path(path) for name, path in re.findall(r"(?m)^(.*?):[ \t]*(\S.*?)\s*$", folders)}
        config = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "wireshark"
        local = Path.home() / ".local/lib/wireshark"
        if os.name == "nt":
            config = local = Path(os.environ["APPDATA"]) / "Wireshark"
        self.config = named.get("Personal configuration", config)
        plugins = named.get("Personal Lua Plugins", local / "plugins")
        # 4.0 does not name the folder of the live ports, and has it in the configuration folder.
        self.extcap = named.get("Personal Extcap path", (self.config if self.tshark else local) / "extcap")
        self.plugin_folders = {named.get("Global Lua Plugins", plugins), plugins, self.config / "plugins"}
        self.name = "Wireshark " + ".".join(map(str, self.version))
        self.target, self.profile = plugins / "yapp", self.config / "profiles/YAPP"


def source_folder() -> Path:
    """Return the folder that has the plugin: in the package, beside this program in the zip, or the repository."""
    here = Path(__file__).resolve().parent
    for folder in (here / "plugin", here, *list(here.parents)[2:3]):
        if (folder / "yapp.lua").is_file() and (folder / "taurus_fields.lua").is_file():
            return folder
    raise Problem(f"{here} has no yapp.lua: unpack the whole zip, and run install.py where it lies")


def plugin_version(path: Path) -> str:
    """Return the version that a yapp.lua says."""
    found = re.search(r'^local VERSION = "(.*)"', path.read_text(encoding="utf-8", errors="replace"), re.MULTILINE)
    return found[1] if found else "unknown"


def wanted_files(source: Path, wireshark: Wireshark) -> dict[Path, bytes]:
    """Return {path: content} of an installation."""
    files = {wireshark.target / name: (source / name).read_bytes() for name in ("yapp.lua", "taurus_fields.lua")}
    if (source / "yapp").is_dir():  # the repository: elsewhere the modules are in one file already
        sys.path.insert(0, str(source / "tools"))
        files[wireshark.target / "yapp.lua"] = importlib.import_module("bundle").bundle(source).encode()
    for path in sorted(source.glob("extcap/*.py")):
        files[wireshark.extcap / path.name] = path.read_bytes()
        if os.name == "nt":  # Wireshark on Windows starts no scripts
            start = f'@"{sys.executable}" "%~dp0{path.name}" %*\r\n'
            files[wireshark.extcap / (path.stem + ".bat")] = start.encode(sys.getfilesystemencoding())
    files.update((wireshark.profile / path.name, path.read_bytes()) for path in sorted(source.glob("profiles/YAPP/*")))
    return files


def remove(path: Path, content: bytes | None) -> None:
    """Remove a file. If it has another content than this, it stays as NAME.old; None removes whatever is there."""
    if content is not None and os.path.lexists(path) and (path.is_symlink() or path.read_bytes() != content):
        old = path.with_name(path.name + ".old")
        os.replace(path, old)
        say("kept", f"{old}: yours, or of another version")
    elif os.path.lexists(path):
        path.unlink()


def install(wireshark: Wireshark, files: dict[Path, bytes]) -> None:
    """Write the files. Those that Wireshark writes itself stay as they are."""
    for path, content in files.items():
        if path.name not in WIRESHARKS or not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            new = path.with_name(path.name + ".part")  # a run that is killed leaves no half of a file
            new.write_bytes(content)
            new.chmod(0o755 if path.parent == wireshark.extcap else 0o644)
            remove(path, content)
            os.replace(new, path)
    for name in ("target", "extcap", "profile"):
        say("installed", getattr(wireshark, name))


def uninstall(wireshark: Wireshark, files: dict[Path, bytes], purge: bool) -> None:
    """Remove the files, and the folders that are empty then; purge: also what is not of this installation."""
    for path, content in files.items():
        remove(path, None if purge or path.name == "recent" else content)
        if purge:
            remove(path.with_name(path.name + ".old"), None)
    for folder in (wireshark.extcap, wireshark.profile, wireshark.target):
        if purge and folder != wireshark.extcap:
            shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # it is not empty
            os.removedirs(folder if folder.exists() else folder.parent)
    left = [folder for folder in (wireshark.profile, wireshark.target) if folder.exists()]
    for folder in left:
        say("kept", f"{folder}: uninstall --purge removes it, too")
    print("Everything else is removed." if left else "Everything is removed.")


def real(path: object) -> str:
    """Return the path without links, in the one way to write it."""
    return os.path.normcase(os.path.realpath(str(path)))


def refuse(source: Path, wireshark: Wireshark) -> None:
    """Raise Problem where it would do harm to install or to uninstall."""
    if os.environ.get("SUDO_USER") and IS_ROOT:
        raise Problem("run it without sudo: everything goes into the home of the user who runs Wireshark")
    if any((real(source) + os.sep).startswith(real(folder) + os.sep) for folder in wireshark.plugin_folders):
        raise Problem(f"{source} is in Wireshark's plugin folder, which loads it as it is: move it elsewhere first")
    for folder in (wireshark.target, wireshark.profile):
        if folder.is_symlink():
            raise Problem(f"{folder} is a link to {folder.resolve()}: remove the link first")


def problems(source: Path, wireshark: Wireshark) -> Iterator[str]:
    """Say what there is, and give the sentences that say what is wrong with it."""
    entry, tshark, name = wireshark.target / "yapp.lua", wireshark.tshark, wireshark.name
    own = plugin_version(source / "yapp.lua")
    if not entry.is_file():
        yield f"nothing is installed in {wireshark.target}"
    elif plugin_version(entry) != own:
        yield f"{entry} is version {plugin_version(entry)}, this is {own}: install it again"
    if not (wireshark.extcap / "yapp_extcap.py").is_file():
        say("note", f"no live ports in {wireshark.extcap}: install it again")
    elif os.name != "nt" and not shutil.which("python3"):
        say("note", "no python3 in PATH, so there are no live ports: they need Python 3.7 or later")
    if not tshark:
        print("tshark was not found, so whether Wireshark loads the plugin was not checked.")
        return
    say("wireshark", f"{name}, Lua {wireshark.lua or 'none'}: {tshark}")
    protocols, errors = ask(tshark, "-G", "protocols")
    loaded = re.findall(r"^yapp\.lua\t.*\t(.*\S)", ask(tshark, "-G", "plugins")[0], re.MULTILINE)
    if wireshark.version < OLDEST:
        yield f"{name} is too old: {'.'.join(map(str, OLDEST))} or later is needed"
    elif not wireshark.lua:
        yield f"{tshark} was built without Lua: install Wireshark's official package, or your distribution's"
    elif loaded and real(loaded[0]) != real(entry):
        yield f"Wireshark loads another copy, {loaded[0]}, instead of {entry}: remove one of them"
    elif re.search(r"\tyapp\s", protocols):
        say("checked", f"{name} loads {entry}")
    elif IS_ROOT and wireshark.version >= NOT_AS_ROOT:
        yield f"as root, {name} runs no Lua plugins: install and run it as an ordinary user"
    elif entry.is_file():
        said = [line for line in errors.splitlines() if "lua" in line.lower()]
        yield "\n  ".join([f"{name} does not load {entry}", *said[:5]])


def run(what: str, purge: bool = False) -> int:
    """Do one of install, check and uninstall. Return the exit code."""
    found = []
    try:
        wireshark, source = Wireshark(), source_folder()
        if what != "check":
            refuse(source, wireshark)
            files = wanted_files(source, wireshark)
        if what == "uninstall":
            uninstall(wireshark, files, purge)
        else:
            if what == "install":
                install(wireshark, files)
            found = list(problems(source, wireshark))
            if what == "install" and not found:
                first = source / "docs/first.pcapng"
                capture = first if first.is_file() else "CAPTURE.pcapng"
                say("next", f"tshark -q -r {capture} -z yapp,faults")
                say("or", f"wireshark -C YAPP {capture}")
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
    code = run(**vars(parser.parse_args()))
    if os.name == "nt" and len(sys.argv) == 1 and sys.stdin.isatty():
        input("Enter closes this window.")  # it was a double click, most likely
    return code


if __name__ == "__main__":
    sys.exit(main())
