# SPDX-License-Identifier: GPL-2.0-or-later
"""tshark starts without tables of names where nothing asks for a name."""

import os

import pytest
from yapp_tables import quick_start


@pytest.fixture
def data(tmp_path, monkeypatch):
    """A Wireshark 4.0 of an ordinary user, its folder of data."""
    folder = tmp_path / "share"
    (folder / "profiles").mkdir(parents=True)
    for name in ("init.lua", "manuf", "services", "enterprises.tsv"):
        (folder / name).write_text(name)
    for name, value in (("DATA", folder), ("TSHARK", tmp_path / "tshark")):
        monkeypatch.setattr(quick_start, name, value)
    for name in ("geteuid", "getegid"):
        monkeypatch.setattr(os, name, lambda: 1000)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("WIRESHARK_DATA_DIR", raising=False)
    quick_start._data_without_names.cache_clear()
    yield folder
    quick_start._data_without_names.cache_clear()


def of(folder, *, needs_names=False):
    return quick_start.environment(str(folder.parent / "tshark"), needs_names=needs_names)


def names(found):
    return sorted(os.listdir(found["WIRESHARK_DATA_DIR"]))


def test_the_rest_of_the_data_is_there(data):
    found = of(data)
    assert names(found) == ["init.lua", "profiles"]
    with open(os.path.join(found["WIRESHARK_DATA_DIR"], "init.lua"), encoding="utf-8") as file:
        assert file.read() == "init.lua"
    assert found["MALLOC_TOP_PAD_"]
    assert of(data) == found


def test_the_folder_is_made_again(data):
    first = of(data)
    for name in names(first):
        os.unlink(os.path.join(first["WIRESHARK_DATA_DIR"], name))
    assert names(of(data)) == ["init.lua", "profiles"]


@pytest.mark.parametrize("why", ["filter", "root", "group", "another tshark", "a later one", "the user's own"])
def test_who_has_all_names(data, monkeypatch, why):
    if why in ("root", "group"):
        monkeypatch.setattr(os, "geteuid" if why == "root" else "getegid", lambda: 0)
    if why == "another tshark":
        monkeypatch.setattr(quick_start, "TSHARK", data / "tshark")
    if why == "a later one":
        (data / "manuf").unlink()
    if why == "the user's own":
        monkeypatch.setenv("WIRESHARK_DATA_DIR", "mine")
    assert of(data, needs_names=why == "filter").get("WIRESHARK_DATA_DIR") == ("mine" if "own" in why else None)
