# SPDX-License-Identifier: GPL-2.0-or-later
"""What `make fuzz` found stays found: test_captures/fuzz/, each with the arguments it failed with."""
import importlib
import sys

import levels
import pytest
import tshark

sys.path.insert(0, str(tshark.ROOT / "tests"))
fuzz = importlib.import_module("fuzz")
BY_SHARKD = levels.without_tshark("runs sharkd, which is a program of its own")
FINDINGS = [pytest.param(path, marks=BY_SHARKD if "\nsharkd" in path.with_suffix(".args").read_text() else ())
            for path in sorted((tshark.CAPTURES / "fuzz").iterdir()) if path.suffix != ".args"]


@pytest.mark.parametrize("path", FINDINGS, ids=lambda path: path.stem)
def test_finding(path):
    """As it was found; in test-all in every principal way too."""
    assert list(fuzz.replay(path, levels.size(fuzz.AS_FOUND, fuzz.EVERY_WAY))) == []


def test_an_error_is_seen(folder, monkeypatch):
    """Where tshark prints no tree, too."""
    tshark.copy_plugin(folder / "plugin")
    path = folder / "plugin/yapp/serial/framer.lua"
    path.write_text(path.read_text().replace("function Framer:add(", 'function Framer:add() error("planted") end\nfunction Framer:add_(', 1))
    monkeypatch.setattr(fuzz, "PLUGIN", folder / "plugin")
    fuzz.homes.cache_clear()
    capture = tshark.CAPTURES / "serial/document_udp.pcap"
    problem = fuzz.show_file(fuzz.Capture(".pcap", b"", [capture.read_bytes()], []), ("-q", "-z", "expert"), folder).problem
    fuzz.homes.cache_clear()
    assert "planted" in (problem or "nothing")
