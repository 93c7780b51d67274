#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""Makes dist/yapp-VERSION.zip, for Windows, macOS and Linux: install.py at its top, or to unpack in the plugin folder; and
dist/yapp-profile-VERSION.zip, for Wireshark's Configuration Profiles, Import, from zip file."""
import pathlib
import re
import zipfile

import bundle

TOP = pathlib.Path(__file__).resolve().parents[1]
WHOLE = ("taurus_fields.lua", "extcap/*.py", "profiles/*/*", "README.md", "CHANGELOG.md",
         "CONTRIBUTING.md", "LICENSE", "docs/*", "tools/pyproject.toml", "tools/README.md", "tools/src/*/*.*")


def pack(name, files):
    """Writes a zip of { name in the zip: path, or its bytes }: the same bytes for the same files."""
    path = TOP / "dist" / name
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for inside, file in sorted(files.items()):
            entry = zipfile.ZipInfo(inside)
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, 3
            entry.external_attr = (0o100755 if inside.endswith(".py") else 0o100644) << 16
            archive.writestr(entry, file if isinstance(file, bytes) else file.read_bytes())
    print(path.relative_to(TOP))


def main():
    version = re.search(r'^local VERSION = "(.*)"', (TOP / "yapp.lua").read_text(encoding="utf-8"), re.MULTILINE)[1]
    files = {f"yapp/{path.relative_to(TOP).as_posix()}": path for pattern in WHOLE for path in TOP.glob(pattern)}
    files["yapp/install.py"] = TOP / "tools/install.py"
    files["yapp/yapp.lua"] = bundle.bundle(TOP).encode()
    pack(f"yapp-{version}.zip", files)
    profile = TOP / "profiles"
    pack(f"yapp-profile-{version}.zip",
         {path.relative_to(profile).as_posix(): path for path in profile.glob("*/*")})


if __name__ == "__main__":
    main()
