"""Wireshark's windows: no error dialog at load, after reloading Lua plugins, after opening another file."""
import pathlib
import shutil
import sys
import time

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import gui  # noqa: E402

pytestmark = pytest.mark.skipif(bool(gui.MISSING), reason=f"not installed: {', '.join(gui.MISSING)}")

# Counts the frames that have Taurus messages each time a file has been dissected, into the file of its name.
PROBE = """
local out = "%s"
local tap, count = Listener.new("frame", "taurus"), 0
function tap.packet() count = count + 1 end
function tap.reset() count = 0 end
function tap.draw()
  local file = io.open(out, "w")
  file:write(count)
  file:close()
end
"""


class Probe:
    """How many frames of Taurus Wireshark sees: it must look again after each step."""

    def __init__(self, folder):
        self.path = pathlib.Path(folder) / "count"
        self.script = pathlib.Path(folder) / "probe.lua"
        self.script.write_text(PROBE % self.path)

    def wait_for(self, count):
        gui.wait_for(lambda: self.path.exists() and self.path.read_text() == str(count), 30)
        self.path.unlink()


def assert_quiet(wireshark, title):
    """One window, that of the file, and nothing from Lua on stderr."""
    time.sleep(1)
    assert len(wireshark.windows()) == 1 and title in list(wireshark.windows())[0], wireshark.windows()
    assert "Lua" not in wireshark.stderr(), wireshark.stderr()
    assert wireshark.wireshark.poll() is None


@pytest.fixture
def captures():
    folder = gui.tshark.writable_folder()
    (folder / "first.pcap").write_bytes(gui.demo())
    shutil.copy(gui.tshark.CAPTURES / "document_udp.pcap", folder / "second.pcap")
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def test_no_error_dialog(captures):
    probe = Probe(captures)
    with gui.Wireshark("-X", f"lua_script:{probe.script}", "-r", captures / "first.pcap") as wireshark:
        wireshark.wait_for_window("first.pcap")
        probe.wait_for(90)
        assert_quiet(wireshark, "first.pcap")

        wireshark.keys("ctrl+shift+l")
        probe.wait_for(90)
        assert_quiet(wireshark, "first.pcap")

        wireshark.filter("taurus.fault.active")
        assert_quiet(wireshark, "first.pcap")

        wireshark.keys("ctrl+o")
        dialog = wireshark.wait_for_window("Open Capture File")
        wireshark.type(captures / "second.pcap")
        wireshark.keys("Return")
        gui.wait_for(lambda: dialog not in wireshark.windows().values())
        wireshark.wait_for_window("second.pcap")
        probe.wait_for(1)
        assert_quiet(wireshark, "second.pcap")

        wireshark.keys("ctrl+shift+l")
        probe.wait_for(1)
        assert_quiet(wireshark, "second.pcap")


def test_an_error_dialog_is_seen(captures):
    """The check itself: a plugin that fails when it loads."""
    for name in gui.tshark.PLUGIN_FILES:
        source = gui.ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, captures / name)
    with open(captures / "yapp.lua", "a") as file:
        file.write('\nerror("planted")\n')
    with gui.Wireshark("-r", captures / "first.pcap", plugin=captures) as wireshark:
        gui.wait_for(wireshark.windows)
        time.sleep(5)
        with pytest.raises(AssertionError):
            assert_quiet(wireshark, "first.pcap")
