# SPDX-License-Identifier: GPL-2.0-or-later
"""The recipes of docs/clients.md, run in order as a user would, and what they print; termshark in a terminal."""

import fcntl
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time

import pytest
from running import TOP, install_plugin

TEXT = (TOP / "docs/clients.md").read_text()
RECIPES = re.findall(r"^```(sh|python)\n(.*?)^```\n(?:\n```text\n(.*?)^```)?", TEXT, re.M | re.S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The captures that the recipes name, and a home with the plugin in it."""
    folder = tmp_path_factory.mktemp("clients")
    shutil.copy(TOP / "docs/flight.pcapng", folder)
    shutil.copy(TOP / "test_captures/serial/udp_several.pcap", folder / "several.pcap")
    install_plugin(folder / "home")
    message = bytes.fromhex(
        "595000001002000020000000fd7ffd7ffd7ffd7ff5affd7f18010000014000000000e38cd23ce04e000005ffbbbe6fc7"
    )
    line = f"000000 {message.hex(' ')}\n"
    subprocess.run(
        ["text2pcap", "-T", "50000,502", "-", "port502.pcap"], cwd=folder, input=line * 3, text=True, check=True
    )
    return folder


def environment(folder):
    path = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"
    return os.environ | {"HOME": str(folder / "home"), "PATH": path, "TERM": "xterm"}


@pytest.mark.parametrize("number", range(len(RECIPES)))
def test_recipe(folder, number):
    language, text, expected = RECIPES[number]
    command = ["bash", "-euo", "pipefail", "-c", text] if language == "sh" else [sys.executable, "-c", text]
    done = subprocess.run(command, cwd=folder, env=environment(folder), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout.strip() == expected.strip()


def is_there(shown):
    """Whether a frame stands there that has a fault as its message has: known on a second look only."""
    return "Motor Data 0x210 (can1) Middle" in " ".join(re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", " ", shown).split())


@pytest.mark.skipif(not shutil.which("termshark"), reason="termshark is not installed")
def test_termshark(folder):
    settings = folder / "home/.config/termshark/termshark.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(re.search(r"^```toml\n(.*?)^```", TEXT, re.M | re.S)[1])
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.execvpe("termshark", re.search(r"`(termshark -r .*?)`", TEXT)[1].split(), environment(folder))
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 50, 180, 0, 0))
    shown, end = "", time.monotonic() + 60
    try:
        while not is_there(shown) and time.monotonic() < end:
            if select.select([terminal], [], [], 0.5)[0]:
                shown += os.read(terminal, 1 << 16).decode("utf-8", "replace")
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert is_there(shown)
