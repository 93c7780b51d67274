# SPDX-License-Identifier: GPL-2.0-or-later
"""The programs of make bench run on a few messages, and the dissector by hand has the plugin's values.  Nothing here is timed."""
import sys

import pytest

import tshark

sys.path.append(str(tshark.ROOT / "tests/bench"))
import bench  # noqa: E402

PEERS = sorted({work.peer for work in bench.WORKS} | {"now"})


@pytest.fixture(scope="module")
def shark():
    folder = tshark.writable_folder()
    bench.prepare(folder, 60, {"now": tshark.PLUGIN})
    return bench.Tshark(None, folder)


@pytest.mark.parametrize("peer", PEERS)
def test_each_peer_runs(shark, peer):
    work = next(work for work in bench.WORKS if peer in (work.peer, "now"))
    medians, ratios = bench.measure_work(shark, work, ["now", peer], 1)
    assert medians[peer][0] > 0 and ratios["now"] == 1


def test_what_fails_is_no_measurement(shark):
    with pytest.raises(AssertionError):
        bench.measure(shark.command(bench.Work("", "no.pcap", []), "now"))


def test_what_is_written_by_hand_has_the_same_values(shark):
    work = bench.Work("", "yapp.pcap", [*bench.VALUES, "-e", bench.FAULT[1], "-e", "taurus.motor.rpm_error"])
    rows = [tshark.run(*shark.command(work, peer)[len(shark.prefix) + 1:], plugin=False).stdout for peer in ("hand", "now")]
    assert rows[0] == rows[1] and len(set(rows[0].split())) > 500
