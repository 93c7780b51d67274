# SPDX-License-Identifier: GPL-2.0-or-later
"""Runs the real tshark with the plugin.  Every run asserts that nothing went wrong in Lua: exit code 0 proves nothing.

YAPP_ROUTE=script (the default) loads the plugin by -X lua_script, YAPP_ROUTE=plugin from a personal plugin folder.
"""
import atexit
import functools
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
import bundle  # noqa: E402
# YAPP_PLUGIN_ROOT: a copy of the plugin, with a fault put in to see whether the tests notice.
PLUGIN = pathlib.Path(os.environ.get("YAPP_PLUGIN_ROOT", ROOT)).resolve()
CAPTURES = ROOT / "test_captures"
PLUGIN_FILES = ["yapp.lua", "taurus_fields.lua", "yapp"]
ROUTE = os.environ.get("YAPP_ROUTE", "script")
TIMEOUT = int(os.environ.get("YAPP_TIMEOUT", 300))
# What Wireshark, GLib and the C library check of their memory, and that Wireshark aborts where it would only report.
STRICT = {"WIRESHARK_DEBUG_WMEM_OVERRIDE": "strict", "WIRESHARK_ABORT_ON_TOO_MANY_ITEMS": "1",
          "WIRESHARK_ABORT_ON_DISSECTOR_BUG": "1", "G_SLICE": "debug-blocks",
          "MALLOC_CHECK_": "3", "GLIBC_TUNABLES": "glibc.malloc.check=3", "LD_PRELOAD": "libc_malloc_debug.so.0"}
if os.environ.get("YAPP_STRICT"):
    os.environ.update(STRICT)  # also for what the tests start by themselves
LUA_ERROR = "_ws.lua.error"  # the field of a packet in which a dissector failed in Lua


@functools.lru_cache(None)
def version():
    """The version of the local tshark: (4, 0, 17)."""
    first = subprocess.run(["tshark", "--version"], capture_output=True, text=True, check=True).stdout.split("\n")[0]
    return tuple(int(part) for part in first.split("(Wireshark)")[1].split()[0].rstrip(".").split("."))


def tells_remote():
    """The fields to name so that a remote frame is told: from 4.4 on -T fields has no column, and no field that is not named."""
    return [] if version() < (4, 2) else ["can.flags.rtr"]


@functools.lru_cache(None)
def plugin_version():
    return re.search(r'^local VERSION = "(.*)"', (PLUGIN / "yapp.lua").read_text(), re.MULTILINE)[1]


@functools.lru_cache(None)
def _user():
    # As root, 4.4 and later ignore Lua plugins without a word.
    return {"user": 65534, "group": 65534, "extra_groups": []} if os.geteuid() == 0 and version() >= (4, 4) else {}


def copy_plugin(folder, root=None):
    """Copies the plugin's files into a folder, which is made; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in PLUGIN_FILES:
        source = (root or PLUGIN) / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
    return folder


def install_plugin(folder, root=None):
    """Puts the plugin into a plugin folder as an installation does, in one file; returns the folder."""
    bundle.write(folder, root or PLUGIN)
    return folder


PERSONAL_FOLDER = pathlib.Path(".local/lib/wireshark/plugins")  # in a home


@functools.lru_cache(None)
def home(plugin=True):
    """A home of its own for the tests, where no profile of the user's has a say; with the plugin in its plugin folder if
    that is the route, or without."""
    path = pathlib.Path(tempfile.mkdtemp(prefix="yapp-home-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    path.chmod(0o755)
    (path / PERSONAL_FOLDER).mkdir(parents=True)
    if plugin and ROUTE == "plugin":
        install_plugin(path / PERSONAL_FOLDER / "yapp")
    if _user():
        for entry in [path, *path.rglob("*")]:
            os.chown(entry, 65534, 65534)
    return path


def load(script=None):
    """The arguments that load the plugin, or another script."""
    if script:
        return ["-X", f"lua_script:{script}"]
    return ["-X", f"lua_script:{PLUGIN / 'yapp.lua'}"] if ROUTE == "script" else []


def run(*arguments, plugin=True, stdin=None, cwd=None, env=None, check=True, lua_errors=False):
    """Runs tshark; returns the completed process (text).  Fails on a Lua error at load, in a tap, and in what shows expert items
    (-V, -T pdml, -z expert); and on exit != 0."""
    environment = {**os.environ, "HOME": str(home(plugin)), "LC_ALL": "C.UTF-8", "TZ": "UTC", **(env or {})}
    environment.pop("XDG_CONFIG_HOME", None)
    command = ["tshark", *(load() if plugin else []), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, stdin=stdin or subprocess.DEVNULL, cwd=cwd, env=environment,
                          timeout=TIMEOUT, **_user())
    done.stdout, done.stderr = done.stdout.decode("utf-8", "replace"), done.stderr.decode("utf-8", "replace")
    if check:
        assert done.returncode == 0, f"{command}\n{done.stderr}"
    if not lua_errors:
        assert "Lua:" not in done.stderr and "Dissector bug, protocol YAPP" not in done.stderr, done.stderr
        assert "Lua Error: " not in done.stdout, re.search("Lua Error: .*", done.stdout)[0]
    return done


def fields(capture, names, *arguments, occurrence="a", separator="\t"):
    """The fields of each frame: a list of lists, as -T fields prints them; several values are joined by commas.

    No dissector may have failed in Lua: that is a field of the packet, and asked for with the others; where a display
    filter chooses among the frames, such a frame is chosen too.  Without a filter each packet has a row, so that no row
    means that nothing was read, and nothing can be compared."""
    wanted = [argument for name in [*names, LUA_ERROR] for argument in ("-e", name)]
    arguments = [f"({after}) || {LUA_ERROR}" if before == "-Y" else after
                 for before, after in zip(["", *arguments], arguments)]
    done = run(*arguments, "-r", capture, "-T", "fields", "-E", f"occurrence={occurrence}", "-E",
               f"separator={separator}", *wanted)
    rows = [line.split(separator) for line in done.stdout.splitlines()]
    assert rows or {"-Y", "-R"} & set(arguments), f"tshark read no packet of {capture}: {done.stderr}"
    assert not any(row[-1] for row in rows), f"Lua error: {[row for row in rows if row[-1]][:3]}"
    return [row[:-1] for row in rows]


def assert_found(capture, rows, *arguments):
    """Display filters (without commas) find their frames and no others; rows are (filter, numbers of frames).

    All in one run, which counts: the frames that a filter finds, and those that it finds of the ones it has to."""
    assert rows, "nothing to find"
    asked = []
    for text, frames in rows:
        asked += [text, f"({text}) && ({' || '.join(f'frame.number == {number}' for number in frames) or 'frame.len < 0'})"]
    asked.append(LUA_ERROR)
    done = run(*arguments, "-q", "-z", ",".join(["io,stat,0", *asked]), "-r", capture)
    counts = re.findall(r"\d+", re.search(r"(?m)^\|[^|]*<>[^|]*\|(.*)\|$", done.stdout)[1])[::2]  # frames and bytes in turns
    wanted = [len(frames) for _, frames in rows for _ in range(2)] + [0]
    assert [int(count) for count in counts] == wanted, [row for row in zip(asked, counts, wanted) if int(row[1]) != row[2]]


def truth(text):
    """A boolean field: 4.0 prints 1 and 0, later versions True and False."""
    return {"1": True, "True": True, "0": False, "False": False}[text]


def flag(value):
    """A boolean for a display filter, the same in every version."""
    return "1" if value else "0"


def writable_folder():
    """A folder that tshark, whoever it runs as, can read and write."""
    return open_to_all(pathlib.Path(tempfile.mkdtemp(prefix="yapp-test-")))


def open_to_all(folder):
    """Lets every user write into a folder and all that is in it; returns the folder."""
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o777)
    return folder
