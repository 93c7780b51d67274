# SPDX-License-Identifier: GPL-2.0-or-later
"""yapp-tables install, check, uninstall: install.py, of which tests/e2e/test_installer.py has the rest."""

import os

import pytest
from running import run_tables


@pytest.fixture
def command(tmp_path):
    """The command in a home of its own, without a tshark."""
    environment = {**os.environ, "HOME": str(tmp_path), "PATH": "/none"}
    for name in ("XDG_CONFIG_HOME", "SUDO_USER"):
        environment.pop(name, None)
    return lambda *arguments: run_tables(tmp_path, *arguments, env=environment)


def files(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_install_check_uninstall(command, tmp_path):
    assert command("install").returncode == 0
    plugin, config = ".local/lib/wireshark/plugins/yapp/", ".config/wireshark/"
    assert {plugin + "yapp.lua", plugin + "taurus_fields.lua", config + "profiles/YAPP/preferences"} <= files(tmp_path)
    assert command("check").returncode == 0
    (tmp_path / plugin / "taurus_fields.lua").write_text("return {}")
    kept = command("uninstall")
    assert kept.returncode == 0
    assert "taurus_fields.lua.old" in kept.stdout
    assert files(tmp_path) == {plugin + "taurus_fields.lua.old"}
    assert command("uninstall", "--purge").returncode == 0
    assert files(tmp_path) == set()
