# SPDX-License-Identifier: GPL-2.0-or-later
import ctypes
import itertools
import os
import pathlib
import shutil
import sys
import tempfile

import pytest

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "test_captures")]
import levels  # noqa: E402
import tshark  # noqa: E402

# A tshark asks for its memory in few large pieces: a seventh of its start, and most tests start one.
os.environ.setdefault("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1")
os.environ.setdefault("MALLOC_TOP_PAD_", str(64 << 20))


SHARE = pathlib.Path("/usr/share/wireshark")
MOUNT_NAMESPACE, PRIVATE, BIND = 0x20000, 0x44000, 0x1000  # of unshare and mount, see linux/sched.h and linux/mount.h


def leave_out_names(config):
    """Start tshark without its tables of vendors, enterprises and ports, which no test asks for: 4.0 reads them twice at each
    start, a third of its time.  Wireshark takes another folder of data from an ordinary user alone; to root they are empty, and so
    are the folders of its own binary plugins, 5 % of a start."""
    tables = [path for path in (SHARE / name for name in ("manuf", "enterprises.tsv", "services")) if path.exists()]
    if not tables or levels.ALL:
        return
    if os.geteuid():
        folder = pathlib.Path(tempfile.mkdtemp(prefix="yapp-share-"))
        config.add_cleanup(lambda: shutil.rmtree(folder))
        for path in set(SHARE.iterdir()) - set(tables):
            (folder / path.name).symlink_to(path)
        os.environ["WIRESHARK_DATA_DIR"] = str(folder)
        return
    libc = ctypes.CDLL(None)
    if libc.unshare(MOUNT_NAMESPACE) == 0 and libc.mount(b"none", b"/", None, PRIVATE, None) == 0:
        for path in tables:
            libc.mount(b"/dev/null", os.fsencode(path), None, BIND, None)
        for path in pathlib.Path("/usr/lib").glob("*/wireshark/plugins/*.*/"):
            libc.mount(b"none", os.fsencode(path), b"tmpfs", 0, None)


def pytest_configure(config):
    leave_out_names(config)
    for line in levels.MARKERS:
        config.addinivalue_line("markers", line)


WAITING = ("test_live.py", "test_watch.py")  # the tests that wait most of their time


def spread(items):
    """The same tests, those that wait between the files of the others: together, they would leave the processors idle."""
    waiting = iter([item for item in items if item.path.name in WAITING])
    ordered = []
    for _, of_file in itertools.groupby((item for item in items if item.path.name not in WAITING), lambda item: item.path):
        ordered += [*of_file, *itertools.islice(waiting, 2)]
    return [*ordered, *waiting]


def pytest_collection_modifyitems(config, items):
    if not any("::" in argument for argument in config.args):  # a test that is asked for by name runs
        chosen = levels.chosen(items)
        config.hook.pytest_deselected(items=sorted(set(items) - set(chosen), key=items.index))
        items[:] = spread(chosen)


@pytest.fixture
def folder():
    path = tshark.writable_folder()
    yield path
    shutil.rmtree(path, ignore_errors=True)
