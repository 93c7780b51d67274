# SPDX-License-Identifier: GPL-2.0-or-later
"""Which module may know of which, by the require lines; CONTRIBUTING.md's picture of it; one file of all, in every Lua."""
import functools
import re
import shutil
import subprocess

import pytest

import tshark

bundle = tshark.bundle
import levels
import module_map  # noqa: E402 in tools/, where bundle is

pytestmark = levels.without_tshark("reads the sources")

FILES = module_map.files(tshark.ROOT)
NAMES = [path.relative_to(tshark.ROOT).as_posix() for path in FILES]
each_file = pytest.mark.parametrize("path", FILES, ids=NAMES)
LUAS = [lua for lua in ("lua5.2", "lua5.4", "lua5.5") if shutil.which(lua)]
ASSIGNED = re.compile(r"^\s*(?:function\s+([\w.:]+)\s*\(|([\w.\[\]\"', ]+?)\s*=[^=])")


@functools.lru_cache(None)
def lines_of(path):
    """The code of a file, without remarks."""
    return [line.split("--")[0].rstrip() for line in path.read_text(encoding="utf-8").split("\n")]


def rank(folder):
    found = [at for at, row in enumerate(module_map.ORDER) if folder in row]
    assert found, f"{folder} has no place in module_map.ORDER"
    return found[0]


@each_file
def test_arrows_lead_down(path):
    here = module_map.folder(path, tshark.ROOT)
    for name, line in module_map.required(path).items():
        there = name.split(".")[1]
        assert there == here or rank(there) > rank(here), f"{path}:{line}: {here} may not know of {name}"
        assert name.replace(".", "/") + ".lua" in NAMES, f"{path}:{line}: there is no {name}"


@each_file
def test_modules_are_required_at_the_head(path):
    """Each as a local name, once, ahead of all named functions: whoever reads the head knows what the file rests on."""
    is_head, seen = True, set()
    for number, line in enumerate(lines_of(path), 1):
        is_head = is_head and not re.search(r"\bfunction [\w.:]+\(", line)
        for name in module_map.REQUIRE.findall(line):
            if name.startswith("yapp."):
                is_head = is_head or path.name == "yapp.lua"  # which requires some when they are first used
                assert is_head and re.match(r" *local [\w, ]+ = require\b", line), f"{path}:{number}: not at the head: {line}"
                assert name not in seen, f"{path}:{number}: {name} once more"
                seen.add(name)
        words = re.findall(r"\brequire\b", line)
        assert len(words) == len(module_map.REQUIRE.findall(line)), f"{path}:{number}: which? {line}"


@each_file
def test_nobody_writes_into_a_module(path):
    required = {name for line in lines_of(path) if re.match(r'local .*\brequire\b.*"yapp\.', line)
                for name in re.match(r"local ([\w, ]+) =", line)[1].split(", ")}
    for number, line in enumerate(lines_of(path), 1):
        found = ASSIGNED.match(line)
        for target in (found[1] or found[2]).split(",") if found else ():
            name = re.match(r"\s*(\w+)[.:\[]", target)
            assert not name or name[1] not in required, f"{path}:{number}: {line}"


def test_the_picture():
    """make map prints it."""
    assert module_map.text(tshark.ROOT) in (tshark.ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), \
        "run make regenerate"


def test_the_modules_that_the_page_names():
    text = (tshark.ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:[a-z]+)/[a-z_]+)(?:[:.]([a-z_]+))?`", text)
    folders = {module_map.folder(path, tshark.ROOT) for path in FILES}
    named = [(name, function) for name, function in named if name.split("/")[0] in folders]
    assert len(named) > 25
    for name, function in named:
        code = (tshark.ROOT / f"yapp/{name}.lua").read_text(encoding="utf-8")
        assert not function or re.search(rf"function [\w.]*[.:]?{function}\(", code), f"{name}: {function}"


def test_the_functions_on_the_way_of_one_frame():
    """Each function in a step stands in the module in front of it."""
    text = (tshark.ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    steps = re.findall(r"^\| (\d+)\. .*\|(.*)\|$", text, re.M)
    assert [int(number) for number, _ in steps] == list(range(1, 11))
    for number, cell in steps:
        code, count = None, 0
        for name in re.findall(r"`([^`]+)`", cell):
            if "/" in name or name == "yapp.lua":
                path = name if name == "yapp.lua" else f"yapp/{name}.lua"
                code = (tshark.ROOT / path).read_text(encoding="utf-8")
            else:
                count += 1
                assert re.search(rf"^(?:local )?function {name}\(|^{name} = ", code, re.M), f"step {number}: {name}"
        assert count, f"step {number} names no function"


@pytest.mark.parametrize("lua", LUAS)
def test_what_is_installed_is_the_same_code(lua, folder):
    """In the same lines, though without comments: the code that Lua makes of it has the number of each line."""
    bundle.write(folder, tshark.ROOT)
    modules = '''
      local count = 0
      local function compile(text, name)
        count = count + 1
        local source = assert(io.open(ROOT .. (name:match("@(yapp/.*)$") or "yapp.lua"), "rb"))
        local expected = assert(load(source:read("a*"), name))
        assert(string.dump(assert(load(text, name))) == string.dump(expected), name)
        return function() end
      end
      assert(load(assert(io.open("yapp.lua", "rb")):read("a*"), "@yapp.lua", "t", setmetatable({ load = compile }, { __index = _G })))()
      for _, run in pairs(package.preload) do run() end
      assert(loadfile("taurus_fields.lua"))
      print(count)'''
    done = subprocess.run([lua, "-"], input=modules.replace("a*", "*a").replace("ROOT", f'"{tshark.ROOT}/"'), cwd=folder, capture_output=True, text=True, check=False)
    assert (done.stderr, done.stdout) == ("", f"{len(FILES)}\n")
