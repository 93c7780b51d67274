#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes what a release has, in dist/, or in the folder that is named: dist.py [FOLDER]

    yapp-VERSION.zip                        for Windows, macOS and Linux: install.py at its top, plugin, live ports, profile, docs
    yapp-profile-VERSION.zip                for Wireshark's Configuration Profiles, Import, from zip file
    yapp_tables-VERSION-py3-none-any.whl    the command yapp-tables, which installs the plugin too
    yapp-samples-VERSION.zip                captures to try it on
    SHA256SUMS

The same commit gives the same bytes on every machine: times are the commit's (SOURCE_DATE_EPOCH), and nothing is compressed,
since each zlib packs in its own way: the wheel is packed anew. The same version of hatchling is needed on all of them. Of docs and tools what git does not know is left out.

YAPP_OWNER is the account that publishes the release: its name takes the place of the word OWNER in pages and jobs.
"""
import hashlib
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time
import zipfile

sys.dont_write_bytecode = True
if sys.version_info < (3, 11):
    sys.exit("dist.py needs Python 3.11 or later")
import bundle  # noqa: E402

OLDEST = "946684800"  # the year 2000: a zip knows no time before 1980
TOP = pathlib.Path(__file__).resolve().parents[1]
DOCUMENTS = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "SECURITY.md", "docs/*", "ci/*", "action.yml",
             "tools/*.py", "tools/pyproject.toml", "tools/README.md", "tools/LICENSE", "tools/src/*/*")


def git(*arguments):
    """What git says of the repository; nothing where there is none."""
    try:
        done = subprocess.run(["git", "-c", "safe.directory=*", "-C", TOP, *arguments], capture_output=True, check=False)
    except FileNotFoundError:
        return ""
    return done.stdout.decode()


def documents():
    """{ place beside install.py: bytes } of what is not installed."""
    known = set(git("ls-files", "-z").split("\0")[:-1])
    found = {path.relative_to(TOP).as_posix(): path for pattern in DOCUMENTS for path in TOP.glob(pattern)}
    owner = os.environ.get("YAPP_OWNER", "").encode() or b"OWNER"
    return {name: re.sub(rb"\bOWNER\b", owner, path.read_bytes()) if path.suffix in (".md", ".yml") else path.read_bytes()
            for name, path in found.items() if path.is_file() and (not known or name in known)}


def whole():
    files = {**documents(), **bundle.installed(TOP)}
    files["install.py"] = files["tools/src/yapp_tables/install.py"]
    files["README.md"] = (TOP / "tools/zip_readme.md").read_bytes()
    del files["tools/install.py"]  # for the repository
    return {f"yapp/{name}": content for name, content in files.items()}


def samples():
    text = (TOP / "docs/samples.md").read_text(encoding="utf-8")
    names = re.findall(r"^\| `(.+?)` \|", text, re.MULTILINE)
    paths = [next(TOP / folder / name for folder in ("test_captures/can", "test_captures/serial", "test_captures/candump", "docs") if (TOP / folder / name).exists())
             for name in names]
    return {"yapp-samples/README.md": text.encode(), **{f"yapp-samples/{path.name}": path.read_bytes() for path in paths}}


def write_zip(path, files):
    """Write { place: bytes }: the same bytes for the same files. Programs are those that begin with #!."""
    when = time.gmtime(int(os.environ["SOURCE_DATE_EPOCH"]))
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in sorted(files.items()):
            entry = zipfile.ZipInfo(name, when[:6])
            entry.create_system = 3
            entry.external_attr = (0o100755 if content.startswith(b"#!") else 0o100644) << 16
            archive.writestr(entry, content)


def wheel():
    """{ the wheel's name: its files }, as hatchling builds it."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], cwd=TOP / "tools",
                              capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{done.stderr}dist.py needs hatchling: apt-get install python3-hatchling, or pip install hatchling")
        path, = pathlib.Path(folder).glob("*.whl")
        with zipfile.ZipFile(path) as archive:
            return {path.name: {name: archive.read(name) for name in archive.namelist()}}


def main(folder):
    os.environ.setdefault("SOURCE_DATE_EPOCH", git("log", "-1", "--format=%ct").strip() or OLDEST)
    version = re.search(r'^local VERSION = "(.*)"', (TOP / "yapp.lua").read_text(encoding="utf-8"), re.MULTILINE)[1]
    folder.mkdir(parents=True, exist_ok=True)
    installed = bundle.installed(TOP)
    profile = {name[len("profiles/"):]: content for name, content in installed.items() if name.startswith("profiles/")}
    zips = {f"yapp-{version}.zip": whole(), f"yapp-profile-{version}.zip": profile, f"yapp-samples-{version}.zip": samples(),
            **wheel()}
    for name, files in zips.items():
        write_zip(folder / name, files)
    names = sorted(zips)
    sums = "".join(f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names)
    (folder / "SHA256SUMS").write_bytes(sums.encode())
    for name in [*names, "SHA256SUMS"]:
        print(folder / name)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else TOP / "dist")
