# SPDX-License-Identifier: GPL-2.0-or-later
"""What SECURITY.md says that the plugin reads and writes, beside the files that strace sees it open."""
import os
import re
import shutil
import subprocess

import pytest

import levels
import tshark

pytestmark = levels.by_route
OWN = """return { { name = "%s", title = "T%s", id = 0x7%s, size = 1, { "value", "uint8", "Value" } } }"""
OPENED = re.compile(r'^\d+ +open(?:at)?\((?:AT_FDCWD, )?"(.*?)", (\S+?)(?:, 0\d+)?\) += \d', re.MULTILINE)


def calls(folder, *arguments):
    """What tshark asks of the system that has to do with files, programs and connections: the lines of strace."""
    if not shutil.which("strace"):
        pytest.skip("no strace")
    log = folder / "log"
    environment = {**os.environ, "HOME": str(folder), "YAPP_MESSAGES": str(folder / "by_environment.lua")}
    done = subprocess.run(["strace", "-f", "-o", log, "-e", "trace=open,openat,creat,unlink,rename,mkdir,execve,fork,vfork,socket,connect",
                           "tshark", *arguments], capture_output=True, text=True, check=False, timeout=tshark.TIMEOUT, env=environment,
                          **tshark._user())
    if not log.exists() or not log.stat().st_size:
        pytest.skip(f"strace is not allowed here: {done.stderr}")
    assert done.returncode == 0, done.stderr
    # Bytes beyond ASCII, such as those of a path with an umlaut, are printed as octal numbers.
    return re.sub(rb"\\([0-7]{1,3})", lambda octal: bytes([int(octal[1], 8)]), log.read_bytes()).decode("utf-8", "replace")


def test_files_and_connections(folder):
    plugin, personal = tshark.install_plugin(folder / tshark.PERSONAL_FOLDER / "yapp"), folder / ".config/wireshark"
    personal.mkdir(parents=True)
    named = [personal / "yapp_messages.lua", folder / "by_preference.lua", folder / "by_environment.lua"]
    for number, path in enumerate(named):
        path.write_text(OWN % (f"own{number}", number, f"0{number}"))
    (personal / "preferences").write_text(f"yapp.messages: {named[1]}\n")
    (folder / "rules.txt").write_text("fault=9\n")
    tshark.open_to_all(folder)
    reads = {*map(str, named), str(folder / "rules.txt"), str(personal / "preferences")}
    asked_for = (f"{folder}/tables/", f"{folder}/report.xml")
    capture = tshark.ROOT / "docs/flight.pcapng"
    asked = ["-z", f"yapp,check,rules={folder}/rules.txt,junit={folder}/report.xml", "-z", f"yapp,csv,{folder}/tables", "-z", "yapp,faults"]
    found = calls(folder, "-q", "-r", capture, *asked)
    (plugin / "yapp.lua").rename(folder / "yapp.lua")
    without = calls(folder, "-q", "-r", capture)
    before = {path for path, _ in OPENED.findall(without)}
    opened = {(path, flags) for path, flags in OPENED.findall(found) if path not in before or path in reads or path == str(capture)}
    read = {path for path, flags in opened if flags.startswith("O_RDONLY")}
    written = [path for path, flags in opened if not flags.startswith("O_RDONLY")]
    written += [path for names in re.findall(r' rename\("(.*?)", "(.*?)"\)', found) for path in names if path not in without]
    assert len(written) > 6 and all(path.startswith(asked_for) for path in written), written
    others = {path for path in read - reads if not path.startswith((str(plugin), "/proc/self/"))}
    assert (read & reads, others) == (reads, {str(capture)})
    for call in ("unlink", "execve", "fork", "vfork", "socket", "connect"):
        assert found.count(f" {call}(") == without.count(f" {call}("), call


@levels.without_tshark("of the page alone")
def test_the_page_names_them():
    page = " ".join((tshark.ROOT / "SECURITY.md").read_text().split())
    for name in ("`yapp_messages.lua`", "`yapp.messages`", "`YAPP_MESSAGES`", "`rules=`", "`preferences`", "`/proc/self`", "`-z yapp,csv`",
                 "`junit=`"):
        assert name in page, name
