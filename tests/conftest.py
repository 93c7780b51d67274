# SPDX-License-Identifier: GPL-2.0-or-later
"""Whoever runs the tests, and wherever: they see a home without an installed plugin, profile or messages, the locale C.UTF-8,
the time zone UTC and the umask of a new account.  This is the only place that says so; a test that needs another home, locale
or zone gives it to the program that it starts."""
import atexit
import os
import pathlib
import re
import shutil
import subprocess
import tempfile

import pytest

SETTINGS = ("XDG_", "WIRESHARK_", "LC_", "LANG", "SUDO_", "YAPP_MESSAGES", "PYTHONUNBUFFERED")

for name in [name for name in os.environ if name.startswith(SETTINGS)]:
    del os.environ[name]
HOME = pathlib.Path(tempfile.mkdtemp(prefix="yapp-user-"))
HOME.chmod(0o755)  # a tshark that an ordinary user runs may look into it
atexit.register(shutil.rmtree, HOME, ignore_errors=True)
os.environ.update(HOME=str(HOME), LC_ALL="C.UTF-8", TZ="UTC")
os.umask(0o022)

# Skips -------------------------------------------------------------------------------------------------------------

# A skip is a decision: the reason that a test gives, where that may be, and on which machine the test runs.  Any other skip fails.
# where: "root", "user", "old" (a Wireshark before 4.4), "new", "route" (the plugin folder), "chroot" (in tests/matrix, where the
# packages of a release are what they are), "clone" (no history), "" anywhere.
SKIPS = [
    ("root installs", "user", "as root: .ci/run"),
    ("needs root, to become somebody else", "user", "as root: .ci/run"),
    ("only root is root", "user new", "as root, Wireshark 4.0: .ci/run"),
    ("strace is not allowed here", "", "where a process may trace its child: .ci/run"),
    ("no strace", "chroot", "make test"),
    ("no filter names a column", "old", "Wireshark 4.4 and 4.6: the workflow test"),
    ("from 4.4 on", "old", "Wireshark 4.4 and 4.6: tests/matrix --gui"),
    ("the same by both routes", "route", "by the other route: make test"),
    ("no zstd here", "", "where zstd is installed: make test"),
    ("no lz4 here", "", "where lz4 is installed: make test"),
    ("python-can is there", "", "where python3-can is not installed: the workflow desktops"),
    ("no pseudo terminals here", "chroot", "make test"),
    ("no repository here", "clone", "in a clone: make test"),
    ("no git here", "chroot clone", "in a clone: make test"),
    ("no /dev/full", "", "on Linux: make test"),
]


def where():
    """What this machine is, of the words of SKIPS."""
    found = {"root" if os.geteuid() == 0 else "user", "chroot" if os.environ.get("YAPP_CHROOT") else "",
             "route" if os.environ.get("YAPP_ROUTE") == "plugin" else ""}
    done = subprocess.run(["tshark", "--version"], capture_output=True, text=True, check=False) if shutil.which("tshark") else None
    version = re.search(r"\b(\d+)\.(\d+)\.\d+", done.stdout if done else "")
    found.add("old" if version and (int(version[1]), int(version[2])) < (4, 4) else "new")
    top = pathlib.Path(__file__).resolve().parents[1]
    shallow = subprocess.run(["git", "-c", "safe.directory=*", "-C", top, "rev-parse", "--is-shallow-repository"], capture_output=True,
                             text=True, check=False) if shutil.which("git") else None
    if not shallow or shallow.returncode or "true" in shallow.stdout:
        found.add("clone")
    return found


def is_allowed(reason):
    here = None
    for text, places, _ in SKIPS:
        if text in reason:
            here = here or where()
            if not places or here & set(places.split()):
                return True
    return False


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item):
    report = (yield).get_result()
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        if not is_allowed(reason):
            report.outcome = "failed"
            report.longrepr = f"{item.nodeid}: {reason}: this skip is not in SKIPS of tests/conftest.py"
