# SPDX-License-Identifier: GPL-2.0-or-later
"""python -m build: the same bytes twice, and what stands in them; the release's wheel is in tests/e2e."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_bytes

import pytest
from running import TOP

INSTALLED = ("yapp.lua", "taurus_fields.lua", "extcap/yapp_extcap.py", "profiles/YAPP/preferences")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Source distribution and wheel, of two copies of the repository with other rights, in two time zones."""
    found = []
    for umask, zone in ((0o022, "UTC"), (0o077, "Asia/Tokyo")):
        folder = tmp_path_factory.mktemp("build")
        for name in ("yapp", "extcap", "profiles", "tools"):
            shutil.copytree(TOP / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "dist"))
        for name in ("yapp.lua", "taurus_fields.lua"):
            shutil.copy(TOP / name, folder)
        environment = {key: text for key, text in os.environ.items() if key not in ("PYTHONPATH", "SOURCE_DATE_EPOCH")}
        command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist", folder / "tools"]
        done = subprocess.run(command, env=environment | {"TZ": zone}, capture_output=True, text=True, umask=umask)
        assert done.returncode == 0, done.stderr
        found.append({path.name: path.read_bytes() for path in (folder / "dist").iterdir()})
    return folder / "dist", found


def test_two_builds_are_the_same(built):
    first, second = built[1]
    assert sorted(name.rpartition(".")[2] for name in first) == ["gz", "whl"]
    assert first == second


def test_both_say_whose_they_are_and_bring_the_plugin(built):
    wheel = zipfile.ZipFile(next(built[0].glob("*.whl")))
    (about,) = [name for name in wheel.namelist() if name.endswith("/METADATA")]
    folder = about.partition("/")[0]
    assert f"{folder}/licenses/LICENSE" in wheel.namelist()
    assert {f"yapp_tables/plugin/{name}" for name in INSTALLED} <= set(wheel.namelist())
    with tarfile.open(next(built[0].glob("*.tar.gz"))) as source:
        top = source.getnames()[0].partition("/")[0]
        names = set(source.getnames())
        texts = [wheel.read(about), source.extractfile(f"{top}/PKG-INFO").read()]
    assert {f"{top}/LICENSE", *(f"{top}/src/yapp_tables/plugin/{name}" for name in INSTALLED)} <= names
    for text in texts:
        said = message_from_bytes(text)
        assert said["License-Expression"] == "GPL-2.0-or-later"
        assert said["Author"]


def test_the_documents_install_the_wheel_that_is_built(built):
    """With ./ in front: pipx 1.1, of Debian 12, takes a name without it for a package of the index."""
    for page in ("docs/tables.md", "docs/install.md", "tools/README.md"):
        (path,) = set(re.findall(r"pipx install '(.*?)'", (TOP / page).read_text()))
        assert path.startswith("./")
        assert path.endswith("[all]")
        assert (built[0] / path.removesuffix("[all]")).is_file()
