# SPDX-License-Identifier: GPL-2.0-or-later
"""What a killed run left is cleaned by the next; a full disk is said with its path and what to do."""

import errno
import os

import pytest
import yapp_tables as yt
from deltalake.exceptions import DeltaError
from running import FAKE, motor_row
from yapp_tables import scratch


def test_what_a_killed_run_left_is_removed_a_day_later(tmp_path):
    old, new = (tmp_path / f"{scratch.PREFIX}{name}" for name in ("old", "new"))
    for path in (old, new, tmp_path / "mine"):
        path.mkdir()
    os.utime(old, (0, 0))
    os.utime(tmp_path / "mine", (0, 0))
    with scratch.scratch(tmp_path) as folder:
        assert folder.is_dir()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", new.name]


def test_a_plugin_that_cannot_write_is_the_same(make_capture):
    says = "yapp: csv: csv/fields.json: No space left on device"
    with pytest.raises(yt.SetupError, match=r"the disk is full: .+; free some space there, or set TMPDIR"):
        yt.read(make_capture("flight.pcapng", motor=[motor_row(0)], says=says), tshark=FAKE)


@pytest.mark.parametrize("kind", [DeltaError, OSError])
def test_a_full_disk_of_a_delta_table_is_said_at_once(make_capture, tmp_path, monkeypatch, kind):
    """deltalake 1.6 raises both, the OSError without a number."""
    tries = []

    def write(*_arguments, **_options):
        tries.append(1)
        raise kind(f"Generic LocalFileSystem error\n \x1b[31m↳\x1b[0m {os.strerror(errno.ENOSPC)} (os error 28)")

    monkeypatch.setattr("yapp_tables.delta.write_deltalake", write)
    with pytest.raises(yt.SetupError, match=r"the disk is full: .+data.yapp-tables; free some space there$"):
        yt.convert_one(
            make_capture("flight.pcapng", motor=[motor_row(0)]), str(tmp_path / "data"), to="delta", tshark=FAKE
        )
    assert len(tries) == 1
