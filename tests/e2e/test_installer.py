# SPDX-License-Identifier: GPL-2.0-or-later
"""tools/install.py, the zips and `make demo`: what is installed where, what a user changed is never lost, nothing is left
behind, and what is wrong is said in a line."""
import hashlib
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import zipfile

import pytest
import tshark

PYTHON = "/usr/bin/python3" if os.path.exists("/usr/bin/python3") else sys.executable
PLUGINS = tshark.PERSONAL_FOLDER
YAPP = PLUGINS / "yapp"
PROFILE = pathlib.Path(".config/wireshark/profiles/YAPP")
EXTCAP = pathlib.Path(".local/lib/wireshark/extcap")  # where 4.4 and later look, and we without a tshark
EXTCAP_4_0 = pathlib.Path(".config/wireshark/extcap")


@pytest.fixture
def home(folder):
    path = folder / "home"
    path.mkdir()
    path.chmod(0o777)
    return path


@pytest.fixture
def source(folder):
    """A copy of the repository's files, to be changed as a later version would."""
    path = folder / "source"
    tshark.copy_plugin(path, tshark.ROOT)
    for name in ("extcap", "profiles", "tools"):
        if (tshark.ROOT / name).is_dir():
            shutil.copytree(tshark.ROOT / name, path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (path / "profiles/YAPP").mkdir(parents=True, exist_ok=True)
    (path / "profiles/YAPP/recently_new").write_text("one\n")
    return path


REAL = os.environ["PATH"]  # with the real tshark, which takes time


def run(home, *arguments, source=tshark.ROOT, code=0, path="/none", env=None):
    """Runs install.py, without a tshark unless path has one; returns its lines, problems among them."""
    program = next(p for p in (source / "install.py", source / "tools/install.py") if p.exists())
    environment = {**os.environ, "HOME": str(home), "LC_ALL": "C.UTF-8", "PATH": path, **(env or {})}
    for name in ("XDG_CONFIG_HOME", "SUDO_USER"):
        if name not in (env or {}):
            environment.pop(name, None)
    done = subprocess.run([PYTHON, program, *arguments], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          text=True, check=False, timeout=120, stdin=subprocess.DEVNULL, **tshark._user())
    assert done.returncode == code, done.stdout
    assert "Traceback" not in done.stdout
    return done.stdout.splitlines()


def all_of(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def line_of(lines, start, part):
    found = [line for line in lines if line.startswith(start) and part in line]
    assert len(found) == 1, lines
    return found[0]


def edit(path, text="-- mine\n"):
    path.chmod(0o666)
    with open(path, "a") as file:
        file.write(text)
    return path.read_bytes()


def test_everything_is_installed_and_removed(home, source):
    lines = run(home, source=source, path=REAL)
    assert any(line.startswith("checked") for line in lines) and not any(line.startswith("kept") for line in lines)
    there = all_of(home / YAPP)
    assert {"yapp.lua", "taurus_fields.lua", "installed.json"} == there
    assert (home / PROFILE / "recently_new").read_text() == "one\n"
    extcap = EXTCAP if tshark.version() >= (4, 4) else EXTCAP_4_0
    for path in (source / "extcap").glob("*.py"):
        assert (home / extcap / path.name).read_bytes() == path.read_bytes()
        assert os.access(home / extcap / path.name, os.X_OK)
    assert run(home, source=source, path=REAL) == lines
    folders = [home / extcap / "yapp_extcap.py", home / PROFILE, home / YAPP]
    assert run(home, "uninstall", source=source, path=REAL) == [f"removed   {path}" for path in folders]
    assert all_of(home) == set()


def test_uninstall_twice(home, source):
    run(home, source=source)
    edit(home / YAPP / "taurus_fields.lua")
    assert f"removed   {home / YAPP}, except what is kept" in run(home, "uninstall", source=source)
    assert not any("removed" in line for line in run(home, "uninstall", source=source))


def test_an_extcap_of_an_earlier_wireshark(home, folder, source):
    """4.0 had it in another folder than 4.4 has: after an upgrade of Wireshark it is in one place again."""
    run(home, source=source, path=other_tshark(folder, "TShark (Wireshark) 4.0.1 (v4.0.1)\nwith Lua 5.2"), code=1)
    assert list((home / EXTCAP_4_0).iterdir())
    run(home, source=source)
    assert not (home / EXTCAP_4_0).exists() and list((home / EXTCAP).iterdir())


def test_it_decodes_when_installed(home):
    run(home)
    done = tshark.run("-r", tshark.CAPTURES / "document_motor.pcap", "-T", "fields", "-e", "taurus.motor.dc_voltage",
                      plugin=False, env={"HOME": str(home)})
    assert done.stdout.strip() == "47.97314" and "yapp" not in done.stderr


def test_folders_of_the_user_stay(home):
    (home / PLUGINS).mkdir(parents=True)
    for path in [home, *home.rglob("*")]:
        path.chmod(0o777)
    before = all_of(home)
    run(home)
    run(home, "uninstall")
    assert all_of(home) == before


def test_a_changed_catalogue_is_kept(home, source):
    run(home, source=source)
    mine = edit(home / YAPP / "taurus_fields.lua")
    assert "you changed it" in line_of(run(home, source=source), "kept", "taurus_fields.lua")
    assert not (home / YAPP / "taurus_fields.lua.new").exists()

    edit(source / "taurus_fields.lua", "-- version 2\n")
    assert "taurus_fields.lua.new" in line_of(run(home, source=source), "kept", "taurus_fields.lua")
    assert (home / YAPP / "taurus_fields.lua").read_bytes() == mine
    assert (home / YAPP / "taurus_fields.lua.new").read_bytes().endswith(b"-- version 2\n")
    edit(source / "taurus_fields.lua", "-- version 3\n")
    run(home, source=source)
    assert (home / YAPP / "taurus_fields.lua.new").read_bytes().endswith(b"-- version 3\n")

    lines = run(home, "uninstall", source=source)
    line_of(lines, "kept", "taurus_fields.lua")
    assert {path for path in all_of(home / PLUGINS) if "." in path} == {"yapp/taurus_fields.lua"}
    assert (home / YAPP / "taurus_fields.lua").read_bytes() == mine
    line_of(run(home, source=source), "kept", "taurus_fields.lua")
    assert (home / YAPP / "taurus_fields.lua").read_bytes() == mine


def test_taking_the_new_catalogue_ends_it(home, source):
    run(home, source=source)
    edit(home / YAPP / "taurus_fields.lua")
    edit(source / "taurus_fields.lua", "-- version 2\n")
    run(home, source=source)
    os.replace(home / YAPP / "taurus_fields.lua.new", home / YAPP / "taurus_fields.lua")
    assert not any(line.startswith("kept") for line in run(home, source=source))
    run(home, "uninstall", source=source)
    assert all_of(home) == set()


def test_changed_code_makes_way_and_is_kept_beside(home, source):
    run(home, source=source)
    installed = (home / YAPP / "yapp.lua").read_bytes()
    mine = edit(home / YAPP / "yapp.lua")
    line_of(run(home, source=source), "replaced", "yapp.lua.edited")
    assert (home / YAPP / "yapp.lua").read_bytes() == installed
    edit(home / YAPP / "yapp.lua", "-- mine again\n")
    line_of(run(home, source=source), "replaced", "yapp.lua.edited2")
    assert (home / YAPP / "yapp.lua.edited").read_bytes() == mine
    line_of(run(home, "uninstall", source=source), "kept", "yapp.lua.edited:")


def test_profile_files_that_the_user_changed(home, source):
    run(home, source=source)
    edit(home / PROFILE / "recently_new")
    (home / PROFILE / "recent").write_text("Wireshark's own\n")
    (source / "profiles/YAPP/recently_new").write_text("two\n")
    line_of(run(home, source=source), "kept", "recently_new")
    assert (home / PROFILE / "recently_new").read_text() == "one\n-- mine\n"
    assert (home / PROFILE / "recently_new.new").read_text() == "two\n"
    lines = run(home, "uninstall", source=source)
    line_of(lines, "kept", "recent:")
    assert all_of(home / PROFILE) == {"recent", "recently_new"}


def test_files_that_a_later_version_does_not_have(home, source):
    """Such as the folder of modules of 2.0: its files go, but for those that the user changed or put there."""
    run(home, source=source)
    modules, names = home / YAPP / "yapp", ("yapp_former.lua", "yapp_other.lua")
    modules.mkdir()
    listed = json.loads((home / YAPP / "installed.json").read_text())
    for name in names:
        (modules / name).write_text("return {}\n")
        listed["files"][str(modules / name)] = hashlib.sha256(b"return {}\n").hexdigest()
    (home / YAPP / "installed.json").write_text(json.dumps(listed))
    mine = edit(modules / "yapp_other.lua")
    (modules / "my_own.lua").write_text("return {}\n")
    line_of(run(home, source=source), "kept", "yapp_other.lua.edited")
    assert {path.name for path in modules.iterdir()} == {"my_own.lua", "yapp_other.lua.edited"}
    assert (modules / "yapp_other.lua.edited").read_bytes() == mine
    run(home, "uninstall", source=source)
    assert {path.name for path in modules.iterdir()} == {"my_own.lua", "yapp_other.lua.edited"}


def git(*arguments):
    """What git says; nothing where there is none."""
    if not shutil.which("git"):
        return b""
    return subprocess.run(["git", "-c", "safe.directory=*", "-C", tshark.ROOT, *arguments], capture_output=True,
                          check=False).stdout


def version_1():
    """The files of 1.0.0, from git: nothing where there is no history."""
    names = git("ls-tree", "-r", "--name-only", "1a1883c", "--", *tshark.PLUGIN_FILES).decode().split()
    return {name: git("show", f"1a1883c:{name}") for name in names}


@pytest.mark.skipif(not version_1(), reason="no git history here")
@pytest.mark.parametrize("edited", [(), ("taurus_fields.lua",), ("taurus_fields.lua", "yapp/yapp_crc.lua")])
def test_upgrade_from_version_1(home, edited):
    for name, content in version_1().items():
        path = home / YAPP / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content + (b"-- mine\n" if name in edited else b""))
    for path in [home, *home.rglob("*")]:
        path.chmod(0o777 if path.is_dir() else 0o666)
    lines = run(home)
    kept = {name: name + ".edited" if name.startswith("yapp/") else name for name in edited}
    for name, place in kept.items():
        assert (home / YAPP / place).read_bytes() == version_1()[name] + b"-- mine\n"
        line_of(lines, "kept", place)
    assert sum(line.startswith("kept") for line in lines) == len(edited)
    run(home, "uninstall")
    there = {path for path in all_of(home / YAPP) if not (home / YAPP / path).is_dir()}
    assert there == set(kept.values())


@pytest.mark.skipif(not version_1(), reason="no git history here")
def test_the_list_of_version_1_is_whole():
    known = (tshark.ROOT / "tools/src/yapp_tables/install.py").read_text()
    for name, content in version_1().items():
        assert hashlib.sha256(content).hexdigest()[:8] in known, name


def test_a_damaged_list(home):
    run(home)
    (home / YAPP / "installed.json").write_text("[")
    assert "installed.json" in run(home, code=1)[-1]


def test_uninstall_without_an_installation(home):
    assert "Nothing is installed" in run(home, "uninstall")[-1]
    assert "nothing is installed" in run(home, "check", code=1)[-1]


# What is wrong --------------------------------------------------------------------------------------------------------

def test_another_copy_is_named(home):
    tshark.copy_plugin(home / PLUGINS / "an-old-one", tshark.ROOT)
    for path in [home, *home.rglob("*")]:
        path.chmod(0o777 if path.is_dir() else 0o666)
    lines = run(home, code=1, path=REAL)
    line_of(lines, "problem", "another copy of the plugin is in " + str(home / PLUGINS / "an-old-one"))
    line_of(lines, "problem", "instead of")


@pytest.mark.parametrize("place", [PLUGINS / "clone", YAPP, pathlib.Path(".config/wireshark/plugins/x")])
def test_not_from_the_plugin_folder(home, source, place):
    (home / place).parent.mkdir(parents=True)
    shutil.copytree(source, home / place)
    for path in [home, *home.rglob("*")]:
        path.chmod(0o777)
    before = all_of(home)
    assert "in Wireshark's plugin folder" in run(home, source=home / place, code=1)[-1]
    assert all_of(home) == before


def test_a_link_to_a_clone_is_not_written_through(home, source):
    (home / PLUGINS).mkdir(parents=True)
    (home / YAPP).symlink_to(source)
    before = {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}
    assert "is a link" in run(home, source=source, code=1)[-1]
    assert {path: path.read_bytes() for path in source.rglob("*") if path.is_file()} == before


def test_links_to_files_are_the_users(home, source):
    mine = home / "my_fields.lua"
    shutil.copy(source / "taurus_fields.lua", mine)
    (home / YAPP).mkdir(parents=True)
    (home / YAPP / "taurus_fields.lua").symlink_to(mine)
    for path in [home, *home.rglob("*")]:
        path.chmod(0o777)
    line_of(run(home, source=source), "kept", "taurus_fields.lua")
    line_of(run(home, "uninstall", source=source), "kept", "taurus_fields.lua")
    assert mine.read_bytes() == (source / "taurus_fields.lua").read_bytes()
    assert (home / YAPP / "taurus_fields.lua").is_symlink()


def other_tshark(folder, about, protocols=""):
    """A PATH with a tshark that says this of itself."""
    program = folder / "bin/tshark"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ncase $* in --version) echo '{about}';; *protocols) echo '{protocols}';; esac\n")
    program.chmod(0o755)
    return f"{program.parent}:/usr/bin:/bin"


@pytest.mark.parametrize("about, part", [
    ("TShark (Wireshark) 3.6.2 (v3.6.2)\nwith Lua 5.2.4", "Wireshark 3.6.2 is too old"),
    ("TShark (Wireshark) 4.2.0 (v4.2.0)\nwith GnuTLS, without Lua, with zlib", "built without Lua"),
    ("TShark (Wireshark) 4.6.0.\n  +Gcrypt  -Lua  +zlib", "built without Lua"),
])
def test_a_tshark_that_cannot(home, folder, about, part):
    lines = run(home, code=1, path=other_tshark(folder, about))
    assert part in "\n".join(line for line in lines if line.startswith("problem"))


@pytest.mark.skipif(os.geteuid() != 0 or tshark.version() >= (4, 4), reason="only root is root")
def test_root(home, folder):
    path = other_tshark(folder, "TShark (Wireshark) 4.4.1.\nwith Lua 5.4")
    line_of(run(home, code=1, path=path), "problem", "as root, Wireshark 4.4.1 runs no Lua plugins")
    assert "without sudo" in run(home, code=1, path=REAL, env={"SUDO_USER": "someone"})[-1]


def test_a_plugin_that_does_not_load(home):
    run(home)
    edit(home / YAPP / "yapp.lua", "syntax error here\n")
    problem = line_of(run(home, "check", code=1, path=REAL), "problem", "does not load")
    assert str(home / YAPP / "yapp.lua") in problem


def test_without_tshark(home):
    assert "was not checked" in run(home)[-1]
    assert (home / YAPP / "yapp.lua").exists() and (home / PROFILE).exists()


# The zips, and make ----------------------------------------------------------------------------------------------------

@pytest.fixture
def zips(folder):
    """Made in a copy of the repository, as git has it."""
    top = folder / "top"
    top.mkdir()
    names = git("ls-files", "-z", "--cached", "--others", "--exclude-standard").decode().split("\0")[:-1]
    names = names or [*tshark.PLUGIN_FILES, "tools", "extcap", "profiles", "docs", "LICENSE",
                      *(path.name for path in tshark.ROOT.glob("*.md"))]
    for name in names:
        if (tshark.ROOT / name).is_dir():
            shutil.copytree(tshark.ROOT / name, top / name)
        elif (tshark.ROOT / name).exists() and not name.startswith(("test_captures/", "tests/")):
            (top / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(tshark.ROOT / name, top / name)
    done = subprocess.run([PYTHON, top / "tools/dist.py"], capture_output=True, text=True, check=True)
    return [top / name for name in done.stdout.split()]


def test_the_zip_installs(home, folder, zips):
    whole, _ = zips
    assert whole.name == f"yapp-{tshark.plugin_version()}.zip"
    zipfile.ZipFile(whole).extractall(folder / "unpacked")
    lines = run(home, source=folder / "unpacked/yapp", path=REAL)
    assert any(line.startswith("checked") for line in lines)
    run(home, "uninstall", source=folder / "unpacked/yapp")
    assert all_of(home) == set()


def test_the_zip_has_what_its_readme_leads_to(zips):
    names = set(zipfile.ZipFile(zips[0]).namelist())
    assert {"yapp/install.py", "yapp/docs/fault.md", "yapp/docs/flight.pcapng", "yapp/tools/pyproject.toml"} <= names
    assert any(name.startswith("yapp/tools/src/yapp_tables/") for name in names)
    readme = (tshark.ROOT / "README.md").read_text()
    for target in re.findall(r"\]\((?!https?:|#)([^)#]*)", readme):
        assert f"yapp/{target}" in names, target


def test_the_zip_unpacked_in_the_plugin_folder(home, zips):
    zipfile.ZipFile(zips[0]).extractall(home / PLUGINS)
    done = tshark.run("-r", tshark.CAPTURES / "document_motor.pcap", "-T", "fields", "-e", "taurus.motor.dc_voltage",
                      plugin=False, env={"HOME": str(home)})
    assert done.stdout.strip() == "47.97314" and "yapp" not in done.stderr


def test_a_zip_is_the_same_each_time(zips):
    again = zips[0].read_bytes()
    subprocess.run([PYTHON, zips[0].parents[1] / "tools/dist.py"], capture_output=True, check=True)
    assert zips[0].read_bytes() == again


def test_demo_leaves_nothing_behind(folder):
    capture = tshark.CAPTURES / "document_command.pcap"
    (folder / "tmp").mkdir()
    done = subprocess.run([tshark.ROOT / "tests/demo", capture], capture_output=True, text=True, check=True,
                          env={**os.environ, "TMPDIR": str(folder / "tmp"), "HOME": str(folder)})
    assert re.search(r"750\.8\d* RPM", done.stdout)
    assert not any((folder / "tmp").iterdir())
