#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes what a release has, in dist/, or in the folder that is named: dist.py [FOLDER]

    yapp-VERSION.zip                        for Windows, macOS and Linux: install.py at its top, plugin, live ports, profile, docs
    yapp-profile-VERSION.zip                for Wireshark's Configuration Profiles, Import, from zip file
    yapp_tables-VERSION-py3-none-any.whl    the command yapp-tables, which installs the plugin too
    yapp-samples-VERSION.zip                captures to try it on
    SHA256SUMS

The same commit gives the same bytes on every machine: times are the commit's (SOURCE_DATE_EPOCH), and nothing is compressed,
since each zlib packs in its own way.  Of docs and tools what git does not know is left out.
"""
import hashlib
import os
import pathlib
import re
import subprocess
import sys

sys.dont_write_bytecode = True
if sys.version_info < (3, 11):
    sys.exit("dist.py needs Python 3.11 or later")
import backend  # noqa: E402
import bundle  # noqa: E402

TOP = pathlib.Path(__file__).resolve().parents[1]
DOCUMENTS = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "docs/*", "ci/*", "action.yml",
             "tools/*.py", "tools/pyproject.toml", "tools/README.md", "tools/src/*/*")


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
    return {name: path.read_bytes() for name, path in found.items() if path.is_file() and (not known or name in known)}


def whole():
    files = {**documents(), **bundle.installed(TOP)}
    files["install.py"] = files["tools/src/yapp_tables/install.py"]
    del files["tools/install.py"]  # for the repository
    return {f"yapp/{name}": content for name, content in files.items()}


def samples():
    text = (TOP / "docs/samples.md").read_text(encoding="utf-8")
    names = re.findall(r"^\| `(.+?)` \|", text, re.MULTILINE)
    paths = [next(TOP / folder / name for folder in ("test_captures", "docs") if (TOP / folder / name).exists())
             for name in names]
    return {"yapp-samples/README.md": text.encode(), **{f"yapp-samples/{path.name}": path.read_bytes() for path in paths}}


def main(folder):
    version = backend.project()["version"]
    os.environ.setdefault("SOURCE_DATE_EPOCH", git("log", "-1", "--format=%ct").strip() or backend.OLDEST)
    folder.mkdir(parents=True, exist_ok=True)
    installed = bundle.installed(TOP)
    profile = {name[len("profiles/"):]: content for name, content in installed.items() if name.startswith("profiles/")}
    zips = {f"yapp-{version}.zip": whole(), f"yapp-profile-{version}.zip": profile, f"yapp-samples-{version}.zip": samples()}
    for name, files in zips.items():
        backend.write_zip(folder / name, files)
    names = sorted([*zips, backend.build_wheel(folder)])
    sums = "".join(f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names)
    (folder / "SHA256SUMS").write_bytes(sums.encode())
    for name in [*names, "SHA256SUMS"]:
        print(folder / name)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else TOP / "dist")
