import pathlib
import shutil
import sys

import pytest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "test_captures")]
import tshark  # noqa: E402


@pytest.fixture
def folder():
    path = tshark.writable_folder()
    yield path
    shutil.rmtree(path, ignore_errors=True)
