# SPDX-License-Identifier: GPL-2.0-or-later
"""Whoever runs the tests, and wherever: they see a home without an installed plugin, profile or messages, the locale C.UTF-8,
the time zone UTC and the umask of a new account.  This is the only place that says so; a test that needs another home, locale
or zone gives it to the program that it starts."""
import atexit
import os
import pathlib
import shutil
import tempfile

SETTINGS = ("XDG_", "WIRESHARK_", "LC_", "LANG", "SUDO_", "YAPP_MESSAGES", "PYTHONUNBUFFERED")

for name in [name for name in os.environ if name.startswith(SETTINGS)]:
    del os.environ[name]
HOME = pathlib.Path(tempfile.mkdtemp(prefix="yapp-user-"))
HOME.chmod(0o755)  # a tshark that an ordinary user runs may look into it
atexit.register(shutil.rmtree, HOME, ignore_errors=True)
os.environ.update(HOME=str(HOME), LC_ALL="C.UTF-8", TZ="UTC")
os.umask(0o022)
