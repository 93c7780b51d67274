# SPDX-License-Identifier: GPL-2.0-or-later
"""Loading: by both routes, twice, from any folder; beside other plugins nothing of theirs is touched."""
import pathlib
import shutil
import uuid

import levels
import pytest
import tshark

pytestmark = levels.by_route
CAPTURE = tshark.CAPTURES / "can/document_motor.pcap"
GLOBALS = pathlib.Path(__file__).with_name("globals.lua")
PLUGINS = ".local/lib/wireshark/plugins"


def install(folder, version=None):
    """A copy of the plugin, as a user or `make install` puts it there."""
    tshark.install_plugin(folder, tshark.ROOT)
    if version:
        entry = folder / "yapp.lua"
        text = entry.read_text()
        assert text.count('local VERSION = "') == 1
        entry.write_text(text.replace('local VERSION = "', f'local VERSION = "{version}-'))
    return folder


def script(folder):
    return ["-X", f"lua_script:{folder / 'yapp.lua'}"]


def load(home, *arguments, **options):
    """Shows the capture; returns stderr of a run in which the plugin decoded it, less what other layers say there."""
    tshark.open_to_all(home)
    done = tshark.run(*arguments, "-r", CAPTURE, "-T", "fields", "-e", "taurus.motor.dc_voltage", "-e",
                      "_ws.lua.error", plugin=False, env={"HOME": str(home)}, **options)
    assert [line.strip()[:5] for line in done.stdout.splitlines() if line.strip()] == ["47.97"], done.stderr
    return [line for line in done.stderr.splitlines() if not line.startswith("Running as user")]


@pytest.fixture
def home(folder):
    """A home without plugins, in a folder with a name of its own: what was loaded before cannot help."""
    path = folder / uuid.uuid4().hex
    path.mkdir()
    return path


def test_plugin_folder(home):
    install(home / PLUGINS / "yapp")
    assert load(home) == []


PLACES = [("a-b+c (copy) 100% grün", "{}/yapp.lua"), ("one;two?three", "{}/yapp.lua"), ("plugin", "plugin/yapp.lua"),
          ("other/plugin", "./other/../other/plugin/yapp.lua")]


@pytest.mark.parametrize("name, path", PLACES)
def test_script_in_any_folder_by_any_path(home, name, path):
    """Lua's package.path takes ";" and "?" for its own."""
    tshark.copy_plugin(home / name)
    assert load(home, "-X", f"lua_script:{path.format(home / name)}", cwd=home) == []


def the_one_line(errors):
    """One line, and it says that one was not loaded and which one was."""
    lines = [line for line in errors if "yapp" in line.lower()]
    assert len(lines) == len(errors) == 1, errors
    assert "is not loaded" in lines[0] and "is already there" in lines[0]
    refused, loaded = lines[0].split(" is not loaded: ")
    return refused, loaded


def test_plugin_folder_and_script_load_once(home):
    install(home / PLUGINS / "yapp", version="1")
    refused, loaded = the_one_line(load(home, *script(install(home / "new", version="2"))))
    assert str(home / "new") in refused and "2-" in refused
    assert PLUGINS in loaded and "1-" in loaded and loaded.endswith("is already there; remove or update one of the two")


def test_plugin_folder_leaves_no_globals(home):
    """Subfolders come first, in order; then the files of the folder itself."""
    install(home / PLUGINS / "yapp")
    (home / PLUGINS / "a").mkdir()
    shutil.copy(GLOBALS, home / PLUGINS / "a/yapptest_first.lua")
    shutil.copy(GLOBALS, home / PLUGINS / "zz_yapptest_last.lua")
    assert load(home) == ["globals: compared"]


def test_script_leaves_no_globals(home):
    before, after = (["-X", f"lua_script:{shutil.copy(GLOBALS, home / name)}"] for name in ("first.lua", "last.lua"))
    assert load(home, *before, *script(install(home / "plugin")), *after) == ["globals: compared"]


def test_a_clone_in_a_plugin_folder(home):
    """Wireshark runs all of its modules, which complain; the plugin works."""
    shutil.copytree(tshark.ROOT, home / PLUGINS / "clone",
                    ignore=shutil.ignore_patterns(".git", "__pycache__", "test_captures", "dist"))
    tshark.open_to_all(home)
    done = tshark.run("-r", CAPTURE, plugin=False, env={"HOME": str(home)}, cwd="/", lua_errors=True)
    assert "Motor Data" in done.stdout
    assert f"{PLUGINS}/clone/yapp/" in done.stderr


@pytest.mark.parametrize("module", ["can/reassembly", "stat/check"])
def test_a_statistic_of_a_broken_plugin_ends_with_21(home, module):
    clone = tshark.copy_plugin(home / "clone", tshark.ROOT)
    (clone / f"yapp/{module}.lua").write_text("local x = = 1\n")
    done = tshark.run(*script(clone), "-q", "-r", CAPTURE, "-z", "yapp,check", plugin=False, env={"HOME": str(home)}, check=False)
    assert done.returncode == 21 and "cannot load" in done.stderr and module in done.stderr
