#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Installs YAPP for Wireshark for the user who runs it: the plugin, the live ports (extcap) and the profile YAPP.

    install.py              install, or bring an installation up to date, and check that Wireshark loads it
    install.py check        only check
    install.py uninstall    remove what was installed

What you changed is never lost.  An upgrade leaves a changed catalogue (taurus_fields.lua) or profile file as it is and puts
the new version beside it as NAME.new; changed code makes way for the new and stays beside it as NAME.edited.  Uninstalling
keeps both.  What was installed is known by the hashes in installed.json, in the plugin's folder.

Python 3.7 or later, nothing but its standard library; Linux, macOS and Windows.
"""
import argparse
import hashlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

# The files of version 1.0.0, which left no list behind: the first 8 digits of their SHA-256.
VERSION_1 = set("""
02a131cf 02b7dbae 02ed48e0 039a1b24 04e74981 06ab1926 09929df2 0d003beb 0e80646d 11616164 1255330f 184c32d4 196fd349
21560bc3 250675a7 2639de4b 26b978a4 295ddb25 2a9224e2 2c94f9c9 2d178ded 2fcf9b24 343c468e 364e11ed 37bf23e6 3a334311
3de11da8 3e216626 43e85a9d 4431f416 45deb55b 4a66655c 51369fb6 52950e86 52ac04db 55bf60ec 58767335 5af7973a 6256b6c5
6270ef85 63fd604a 668938b8 67b4b839 680d35c8 6ebaef24 71dc8b1c 778cc0be 79fa0c75 7bbbe7a0 7d1f6780 7deb33fd 800f5f1f
80494c43 81efc0e1 836c088c 8396b192 848baec8 866b3858 88a9fd9b 8c6748b7 8fec3e4f 912d9b47 95b79550 95d02745 966a6aae
976e7e7e 98c7d4c6 9a407302 9cf1d208 9e777c92 a073820e a388c88c a68e530e a955ab6e a9e35b5b aa139401 aefc6f44 b0fb5eaa
b398c75b b8cf2eab b9c2f8bd bce38c2f bec73a66 c36bb9e5 c453260c c4605cc6 c6b72acc cc5fc6ad cd62550e d4c37483 d6dd83aa
d84b8a74 d93b479b dcd8e03f dda48212 ddf59efc df805704 e9c81f20 ef8f3129 f1faf856 f4d52614 f5c91c6c fc6a40e1 fd1335a4
ff395b6e
""".split())
OLDEST = (4, 0)  # Wireshark
SETTLED = (4, 4)  # from here on root runs no Lua plugins
TO_EDIT = ("taurus_fields.lua",)  # and everything in the profile


class Problem(Exception):
    """What stands in the way, as a sentence for the user."""


# Wireshark ------------------------------------------------------------------------------------------------------------

def find_tshark():
    """The path of tshark, or None."""
    places = [os.path.join(os.environ.get(name, "?"), "Wireshark", "tshark.exe")
              for name in ("ProgramW6432", "ProgramFiles", "ProgramFiles(x86)")]
    places.append("/Applications/Wireshark.app/Contents/MacOS/tshark")
    return shutil.which("tshark") or next((path for path in places if os.path.exists(path)), None)


def ask(tshark, *arguments):
    """What tshark prints: stdout and stderr."""
    done = subprocess.run([tshark, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
                          check=False, timeout=120)
    return done.stdout.decode("utf-8", "replace"), done.stderr.decode("utf-8", "replace")


class Wireshark:
    """The installed Wireshark, as far as it is there: tshark, version, has_lua and the personal folders config, plugins and
    extcap; plugin_folders are all that Lua plugins are loaded from."""

    def __init__(self):
        self.tshark = find_tshark()
        self.version, self.has_lua, named = None, True, {}
        if self.tshark:
            about = ask(self.tshark, "--version")[0]
            self.version = tuple(int(part) for part in re.search(r"(\d+)\.(\d+)\.(\d+)", about).groups())
            self.has_lua = re.search(r"(with |\+)Lua\b", about) is not None
            lines = (line.partition(":") for line in ask(self.tshark, "-G", "folders")[0].splitlines())
            named = {name.strip(): pathlib.Path(path.strip()) for name, _, path in lines if path.strip()}
        self.config = named.get("Personal configuration") or self.usual_config()
        local = self.config if os.name == "nt" else pathlib.Path.home() / ".local/lib/wireshark"
        self.plugins = named.get("Personal Lua Plugins") or local / "plugins"
        # 4.0 does not name it, and has it in the configuration folder.
        self.extcap = named.get("Personal Extcap path") or (self.config if self.tshark else local) / "extcap"
        self.plugin_folders = [folder for folder in (named.get("Global Lua Plugins"), self.plugins, self.config / "plugins")
                               if folder]

    @staticmethod
    def usual_config():
        """Where the configuration is when there is no tshark to ask."""
        if os.name == "nt":
            return pathlib.Path(os.environ["APPDATA"]) / "Wireshark"
        return pathlib.Path(os.environ.get("XDG_CONFIG_HOME") or pathlib.Path.home() / ".config") / "wireshark"

    @property
    def profile(self):
        return self.config / "profiles" / "YAPP"


# The files -------------------------------------------------------------------------------------------------------------

def digest(data):
    return hashlib.sha256(data).hexdigest()


def source_folder():
    """The folder that has the plugin: this program's own in the zip, the one above it in the repository."""
    here = pathlib.Path(__file__).resolve().parent
    for folder in (here, here.parent):
        if (folder / "yapp.lua").is_file() and (folder / "taurus_fields.lua").is_file():
            return folder
    raise Problem(f"{here} has no yapp.lua: unpack the whole zip, and run install.py where it lies")


def wanted_files(source, wireshark):
    """What belongs where: { path: content }."""
    target = wireshark.plugins / "yapp"
    files = {target / name: (source / name).read_bytes() for name in ("yapp.lua", "taurus_fields.lua")}
    if (source / "yapp").is_dir():  # the repository: the zip has them in one file already
        import bundle
        files[target / "yapp.lua"] = bundle.bundle(source).encode()
    for folder, to, pattern in ((source / "extcap", wireshark.extcap, "*.py"),
                                (source / "profiles/YAPP", wireshark.profile, "*")):
        for path in sorted(folder.glob(pattern)):
            files[to / path.name] = path.read_bytes()
            if os.name == "nt" and path.suffix == ".py":  # Wireshark on Windows starts no scripts
                start = f'@"{sys.executable}" "%~dp0{path.name}" %*\r\n'
                files[to / (path.stem + ".bat")] = start.encode(sys.getfilesystemencoding())
    return files


class Installation:
    """What is installed, by the list that an installation leaves behind: hashes { path: SHA-256 of what was installed there,
    or would have been had the user not changed it }, and the folders that were made for it."""

    def __init__(self, wireshark):
        self.wireshark = wireshark
        self.target = wireshark.plugins / "yapp"
        self.list = self.target / "installed.json"
        self.hashes, self.folders, self.said = {}, [], set()
        if self.list.is_file():
            try:
                content = json.loads(self.list.read_text(encoding="utf-8"))
                self.hashes = {pathlib.Path(path): value for path, value in content["files"].items()}
                self.folders = [pathlib.Path(path) for path in content["folders"]]
            except (ValueError, KeyError, AttributeError) as problem:
                raise Problem(f"{self.list} is damaged; remove it, then every file counts as changed") from problem
        self.contents = set(self.hashes.values())

    def say(self, what, path, why):
        print(f"{what:<9} {path}: {why}")
        self.said.add(path)

    def is_ours(self, path):
        """Whether the file is as some installation left it."""
        if path.is_symlink() or not path.is_file():
            return False
        content = digest(path.read_bytes())
        return content in self.contents or content[:8] in VERSION_1

    def candidates(self):
        """Paths of the earlier installation; those that may be, where it left no list."""
        return set(self.hashes) or {*self.target.glob("*.lua"), *self.target.glob("yapp/*.lua")}

    def write(self, path, content):
        missing = [folder for folder in path.parents if not folder.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        self.folders += [folder for folder in missing if folder not in self.folders]
        new = path.with_name(path.name + ".part")
        new.write_bytes(content)
        new.chmod(0o755 if path.parent == self.wireshark.extcap else 0o644)
        os.replace(str(new), str(path))
        self.hashes[path] = digest(content)

    def put(self, path, content):
        """Brings one file up to date; what the user changed stays, in its place or beside it."""
        before, now = self.hashes.get(path), digest(content)
        beside = path.with_name(path.name + ".new")
        there = os.path.lexists(str(path))
        if not there or self.is_ours(path) or (not path.is_symlink() and digest(path.read_bytes()) == now):
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
    def set_aside(path):
        """Renames a file to a name that is free and that Wireshark does not run; returns the new path."""
        count, aside = 1, path.with_name(path.name + ".edited")
        while os.path.lexists(str(aside)):
            count += 1
            aside = path.with_name(f"{path.name}.edited{count}")
        path.rename(aside)
        if not aside.is_symlink():
            aside.chmod(0o644)
        return aside

    def remove(self, path):
        """Removes a file that is as it was installed, and says so of one that is not."""
        if self.is_ours(path):
            path.unlink()
        elif path in self.hashes and os.path.lexists(str(path)):
            self.say("kept", path, "you changed it")
        self.hashes.pop(path, None)

    def install(self, files):
        for path in self.candidates() - set(files):
            if path.suffix != ".new" or path.with_suffix("") not in files:
                self.remove(path)  # of an earlier version, or of another Wireshark's folder
        for path, content in files.items():
            self.put(path, content)
        self.remove_folders(self.folders)
        made = [str(folder) for folder in self.folders if folder.is_dir()]
        content = {"files": {str(path): value for path, value in self.hashes.items()}, "folders": made}
        self.list.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def uninstall(self):
        own = [self.target / "yapp", self.target, self.wireshark.profile]
        for path in self.candidates():
            self.remove(path)
        if self.list.exists():
            self.list.unlink()
        self.remove_folders([*own, *self.folders])
        for path in sorted(path for folder in own for path in folder.glob("*")):
            if path not in own and path not in self.said:
                self.say("kept", path, "it is not as it was installed")

    @staticmethod
    def remove_folders(folders):
        """Removes those that are empty, deepest first."""
        for folder in sorted(set(folders), key=lambda folder: -len(folder.parts)):
            if folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir()):
                folder.rmdir()


# What is wrong ---------------------------------------------------------------------------------------------------------

def real(path):
    return os.path.normcase(os.path.realpath(path))


def copies(wireshark):
    """The folders with a yapp.lua from which Wireshark may load it."""
    found = {real(path): path.parent for folder in wireshark.plugin_folders for path in folder.glob("**/yapp.lua")}
    return list(found.values())


def refuse_to_install(source, wireshark):
    """Raises where an installation would do harm."""
    if os.environ.get("SUDO_USER") and os.geteuid() == 0:
        raise Problem("run it without sudo: everything goes into the home of the user who runs Wireshark")
    for folder in wireshark.plugin_folders:
        if real(source) == real(folder) or real(source).startswith(real(folder) + os.sep):
            raise Problem(f"{source} is in Wireshark's plugin folder, from which it is loaded as it is: move it elsewhere "
                          "(your own changes with it), and run this again there")
    for folder in (wireshark.plugins / "yapp", wireshark.plugins / "yapp/yapp", wireshark.profile):
        if folder.is_symlink():
            raise Problem(f"{folder} is a link to {folder.resolve()}: remove the link first")


def problems(wireshark):
    """Sentences that say what is wrong with the installation."""
    target = wireshark.plugins / "yapp"
    others = [folder for folder in copies(wireshark) if real(folder) != real(target)]
    for folder in others:
        yield f"another copy of the plugin is in {folder}: Wireshark loads only one; remove one of them"
    if not (target / "yapp.lua").is_file():
        yield f"nothing is installed in {target}"
    elif not wireshark.tshark:
        print("tshark was not found, so whether Wireshark loads the plugin was not checked.")
    else:
        yield from loading_problems(wireshark, target)


def loading_problems(wireshark, target):
    text = ".".join(map(str, wireshark.version))
    if wireshark.version < OLDEST:
        yield f"Wireshark {text} is too old: {OLDEST[0]}.{OLDEST[1]} or later is needed"
    if not wireshark.has_lua:
        yield f"{wireshark.tshark} was built without Lua: install Wireshark's official package, or your distribution's"
    protocols, errors = ask(wireshark.tshark, "-G", "protocols")
    if re.search(r"\tyapp\s", protocols):
        plugins = ask(wireshark.tshark, "-G", "plugins")[0]
        loaded = [line.split("\t")[-1].strip() for line in plugins.splitlines() if line.startswith("yapp.lua\t")]
        if loaded and real(loaded[0]) != real(target / "yapp.lua"):
            yield f"Wireshark loads {loaded[0]} instead of {target / 'yapp.lua'}"
        else:
            print(f"checked   Wireshark {text} loads {target / 'yapp.lua'}")
    elif hasattr(os, "geteuid") and os.geteuid() == 0 and wireshark.version >= SETTLED:
        yield f"as root, Wireshark {text} runs no Lua plugins: install and run it as an ordinary user"
    elif wireshark.has_lua and wireshark.version >= OLDEST:
        said = [line for line in errors.splitlines() if "Lua" in line or "lua" in line]
        yield f"Wireshark {text} does not load {target / 'yapp.lua'}" + "".join(f"\n  {line}" for line in said[:5])


# ------------------------------------------------------------------------------------------------------------------------

def install(wireshark):
    source = source_folder()
    refuse_to_install(source, wireshark)
    Installation(wireshark).install(wanted_files(source, wireshark))
    print(f"plugin    {wireshark.plugins / 'yapp'}")
    for name, there in (("extcap", wireshark.extcap), ("profile", wireshark.profile)):
        if there.is_dir():
            print(f"{name:<9} {there}")


def contents(path):
    """What is there: the path, and those in it."""
    return [each for each in (path, *path.rglob("*")) if os.path.lexists(str(each))]


def uninstall(wireshark):
    installation = Installation(wireshark)
    if not installation.target.exists():
        print(f"Nothing is installed in {installation.target}")
        return
    files = [path for path in installation.hashes if path.parent == wireshark.extcap]
    there = {path: contents(path) for path in (*sorted(files), wireshark.profile, installation.target)}
    installation.uninstall()
    for path, before in there.items():
        if contents(path) != before:
            print(f"removed   {path}{', except what is kept' if path.exists() else ''}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("install", "check", "uninstall"), default="install")
    what = parser.parse_args().what
    found = []
    try:
        wireshark = Wireshark()
        if what != "check":
            {"install": install, "uninstall": uninstall}[what](wireshark)
        if what != "uninstall":
            found = list(problems(wireshark))
    except (Problem, OSError, subprocess.SubprocessError) as problem:
        found = [str(problem)]
    for text in found:
        print(f"problem   {text}", file=sys.stderr)
    if os.name == "nt" and len(sys.argv) == 1 and sys.stdin.isatty():
        input("Enter closes this window.")  # it was a double click, most likely
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
