# SPDX-License-Identifier: GPL-2.0-or-later
"""tools/install.py, the zips and `make demo`: what is installed where, what a user changed is never lost, nothing is left
behind, and what is wrong is said in a line."""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import zipfile

import levels
import pytest
import tshark

pytestmark = levels.without_tshark("of the installer, with a tshark of its own")

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
    for name in ("XDG_CONFIG_HOME", "SUDO_USER", "PYTHONUNBUFFERED"):
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
    assert {"yapp.lua", "taurus_fields.lua"} == there
    assert (home / PROFILE / "recently_new").read_text() == "one\n"
    extcap = EXTCAP if tshark.version() >= (4, 4) else EXTCAP_4_0
    for path in (source / "extcap").glob("*.py"):
        assert (home / extcap / path.name).read_bytes() == path.read_bytes()
        assert os.access(home / extcap / path.name, os.X_OK)
    assert run(home, source=source, path=REAL) == lines
    assert run(home, "uninstall", source=source, path=REAL) == ["Everything is removed."]
    assert all_of(home) == set()


def test_a_file_that_the_user_changed_stays_as_old(home, source):
    run(home, source=source)
    theirs = {name: edit(home / name) for name in (YAPP / "taurus_fields.lua", PROFILE / "recently_new")}
    edit(source / "taurus_fields.lua", "-- version 2\n")
    lines = run(home, source=source)
    for name, content in theirs.items():
        line_of(lines, "kept", f"{home / name}.old")
        assert (home / f"{name}.old").read_bytes() == content
    assert (home / YAPP / "taurus_fields.lua").read_bytes() == (source / "taurus_fields.lua").read_bytes()
    assert not any(line.startswith("kept") for line in run(home, source=source))
    lines = run(home, "uninstall", source=source)
    assert all(line_of(lines, "kept", f"{home / folder}: uninstall --purge") for folder in (YAPP, PROFILE))
    assert {name for name in all_of(home) if (home / name).is_file()} == {f"{name}.old" for name in theirs}


def test_what_wireshark_writes_into_the_profile_stays(home, source):
    run(home, source=source)
    for name in ("recent", "preferences"):
        edit(home / PROFILE / name, "# Wireshark's own\n")
    assert not any(line.startswith("kept") for line in run(home, source=source))
    assert b"Wireshark's own" in (home / PROFILE / "preferences").read_bytes()
    run(home, "uninstall", source=source)
    assert all_of(home / PROFILE) == {"preferences.old"}


def test_purge(home, source):
    (home / ".config/wireshark").mkdir(parents=True)
    (home / ".config/wireshark/preferences").write_text("")
    tshark.open_to_all(home / ".config")
    run(home, source=source)
    for name in ("yapp.lua", "taurus_fields.lua"):
        edit(home / YAPP / name)
    edit(home / EXTCAP / "yapp_extcap.py", "# mine\n")
    edit(source / "profiles/YAPP/colorfilters")
    edit(home / PROFILE / "colorfilters", "# @mine@\n@mine@tcp@[0,0,0][1,1,1]\n")
    run(home, source=source)
    run(home, "uninstall", "--purge", source=source)
    assert all_of(home) == {".config", ".config/wireshark", ".config/wireshark/preferences"}
    run(home, "uninstall", source=source)


# What is wrong --------------------------------------------------------------------------------------------------------

def test_another_copy_is_named(home):
    tshark.copy_plugin(home / PLUGINS / "an-old-one", tshark.ROOT)
    tshark.open_to_all(home)
    lines = run(home, code=1, path=REAL)
    line_of(lines, "problem", f"another copy, {home / PLUGINS / 'an-old-one/yapp.lua'}, instead of")


@pytest.mark.parametrize("place", [PLUGINS / "clone", YAPP, pathlib.Path(".config/wireshark/plugins/x")])
def test_not_from_the_plugin_folder(home, source, place):
    (home / place).parent.mkdir(parents=True)
    shutil.copytree(source, home / place)
    tshark.open_to_all(home)
    before = all_of(home)
    assert "in Wireshark's plugin folder" in run(home, source=home / place, code=1)[-1]
    assert all_of(home) == before


def test_a_link_to_a_clone_is_not_written_through(home, source):
    (home / PLUGINS).mkdir(parents=True)
    (home / YAPP).symlink_to(source)
    before = {path: path.read_bytes() for path in source.rglob("*") if path.is_file()}
    for what in ("install", "uninstall"):
        assert "is a link" in run(home, what, source=source, code=1)[-1]
    assert {path: path.read_bytes() for path in source.rglob("*") if path.is_file()} == before


def program(path, *lines):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]))
    path.chmod(0o755)
    return path


def other_tshark(folder, about, protocols="", plugins=""):
    """A PATH with a tshark that says this of itself."""
    place = program(folder / "bin/tshark", f"case $* in --version) echo '{about}';; *protocols) echo '{protocols}';;",
                    f"*plugins) echo '{plugins}';; esac")
    return f"{place.parent}:/usr/bin:/bin"


@pytest.mark.parametrize("about, part", [
    ("TShark (Wireshark) 3.6.2 (v3.6.2)\nwith Lua 5.2.4", "Wireshark 3.6.2 is too old"),
    ("TShark (Wireshark) 4.2.0 (v4.2.0)\nwith GnuTLS, without Lua, with zlib", "built without Lua"),
    ("TShark (Wireshark) 4.6.0.\n  +Gcrypt  -Lua  +zlib", "built without Lua"),
    ("cannot open shared object", "does not say its version"),
])
def test_a_tshark_that_cannot(home, folder, about, part):
    lines = run(home, code=1, path=other_tshark(folder, about))
    assert part in "\n".join(line for line in lines if line.startswith("problem"))


def test_an_old_one(home, source):
    run(home, source=source)
    entry = source / "yapp.lua"
    entry.write_text(entry.read_text().replace('local VERSION = "', 'local VERSION = "9.'))
    problem = line_of(run(home, "check", source=source, code=1), "problem", f"is version {tshark.plugin_version()}")
    assert f"this is 9.{tshark.plugin_version()}: install it again" in problem
    assert not any("problem" in line for line in run(home, source=source))


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


# The zips, and make ----------------------------------------------------------------------------------------------------

DIST = ["yapp-{}.zip", "yapp-profile-{}.zip", "yapp-samples-{}.zip", "yapp_tables-{}-py3-none-any.whl", "SHA256SUMS"]


def git(*arguments):
    """What git says; nothing where there is none."""
    if not shutil.which("git"):
        return b""
    return subprocess.run(["git", "-c", "safe.directory=*", "-C", tshark.ROOT, *arguments], capture_output=True, check=False).stdout


def repository(top):
    """A copy of the repository, as git has it, without the tests."""
    names = git("ls-files", "-z", "--cached", "--others", "--exclude-standard").decode().split("\0")[:-1]
    names = names or [*tshark.PLUGIN_FILES, "tools", "extcap", "profiles", "docs", "test_captures", "ci", "action.yml",
                      "LICENSE", *(path.name for path in tshark.ROOT.glob("*.md"))]
    for name in names:
        if (tshark.ROOT / name).is_dir():
            shutil.copytree(tshark.ROOT / name, top / name)
        elif (tshark.ROOT / name).exists() and not name.startswith("tests/"):
            (top / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(tshark.ROOT / name, top / name)
    return top


@pytest.fixture(scope="module")
def zips():
    """What make dist makes, in the order of DIST."""
    folder = tshark.writable_folder()
    done = subprocess.run([PYTHON, repository(folder / "top") / "tools/dist.py"], capture_output=True, text=True, check=True)
    made = {pathlib.Path(line).name: pathlib.Path(line) for line in done.stdout.splitlines()}
    yield [made[name.format(tshark.plugin_version())] for name in DIST]
    shutil.rmtree(folder, ignore_errors=True)


def test_the_readme_of_the_zip(home, folder, zips):
    """Its commands need nothing but what is in it, and every file that it names is there."""
    zipfile.ZipFile(zips[0]).extractall(folder)
    text = (folder / "yapp/README.md").read_text()
    rows = re.findall(r"`([^`]+)`", "".join(re.findall(r"^\| `.*?\|", text, re.MULTILINE)))
    assert len(rows) > 7 and all((folder / "yapp" / name).exists() for name in rows)
    commands = re.findall(r"^    (.*)", text, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["python3", "python", "tshark", "wireshark"]
    assert "make " not in text
    assert any(line.startswith("checked") for line in run(home, source=folder / "yapp", path=REAL))
    done = tshark.run(*commands[2].split()[1:], plugin=False, env={"HOME": str(home)}, cwd=folder / "yapp")
    assert "motor_overcurrent" in done.stdout
    run(home, "uninstall", source=folder / "yapp")
    assert not (home / YAPP).exists()


def test_one_version():
    """In all places."""
    version = tshark.plugin_version()
    places = {"tools/src/yapp_tables/__init__.py": r'^__version__ = "(.*)"', "extcap/yapp_extcap.py": r'^VERSION = "(.*)"',
              "CHANGELOG.md": r"^## \[(.*?)\]", "action.yml": r"@v(.*)$", "ci/gitlab-yapp.yml": r"YAPP_VERSION: v(.*)$",
              "docs/ci.md": r"@v(.*)$", "docs/tables.md": r"yapp_tables-([\d.]+)-", "tools/README.md": r"yapp_tables-([\d.]+)-"}
    for name, pattern in places.items():
        assert re.search(pattern, (tshark.ROOT / name).read_text(), re.MULTILINE)[1] == version, name


DEMOS = [("docs/first.pcapng", "motor_overcurrent +raised"), ("test_captures/can/document_command.pcap", r"750\.8\d* RPM"),
         (None, "No Taurus message")]


@pytest.mark.parametrize("capture, shown", levels.few(DEMOS, DEMOS[::2], several=True))
def test_demo(folder, capture, shown):
    """The fault, a screen long, and what to do next; nothing is on stderr, and nothing stays behind."""
    if capture is None:  # a capture without a packet
        capture = folder / "empty.pcap"
        capture.write_bytes((tshark.CAPTURES / "can/document_command.pcap").read_bytes()[:24])
    (folder / "tmp").mkdir(mode=0o777)
    done = subprocess.run([tshark.ROOT / "tests/demo", capture], capture_output=True, text=True, check=True, cwd=tshark.ROOT,
                          env={**os.environ, "TMPDIR": str(folder / "tmp"), "HOME": str(folder)})
    assert not done.stderr and not any((folder / "tmp").iterdir())
    assert re.search(shown, done.stdout) and "Severity" not in done.stdout  # expert items repeat the flags
    lines = done.stdout.splitlines()
    assert len(lines) <= 60 and "Next: make install, then open" in lines[-1]
