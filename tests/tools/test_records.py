# SPDX-License-Identifier: GPL-2.0-or-later
"""Incidents of a flight: what belongs together is one, whatever flags it raised."""

from decimal import Decimal

import pytest
from fake_tshark import FIELDS
from yapp_tables.incidents import faults_in
from yapp_tables.tables import columns_of, table


def event(at, kind="fault", flag="stall", **more):
    row = {"kind": kind, "time": Decimal(1_700_000_000) + Decimal(str(at)), "frame": 1, "bus": "can0", "id": 0x210}
    row |= {"source": None, "message": "motor"}
    return row | ({"field": "f", "flag": flag, "event": "raised"} if kind == "fault" else {}) | more


def cleared(at, **more):
    return event(at, event="cleared", active=1.0, **more)


@pytest.mark.parametrize(
    ("rows", "count"),
    [
        ([], 0),
        ([event(0, kind="reboot")], 0),
        # A flag and the state `faulted` beside it.
        ([event(0), event(0, flag="faulted", field="s"), cleared(1), cleared(1, flag="faulted", field="s")], 1),
        # It comes again within two seconds, and after more.
        ([event(0), cleared(1), event(2.5), cleared(3)], 1),
        ([event(0), cleared(1), event(3.5), cleared(4)], 2),
        # Never cleared: all that follows is the same incident.
        ([event(0), event(100, flag="other")], 1),
        # A fault, then silence, then a reboot and another fault.
        ([event(0), event(0.1, kind="silence", length=30.0), cleared(30.1), event(31, kind="reboot"), event(32)], 1),
        # Two controllers; Motor Data and Health of one.
        ([event(0), event(0, id=0x211), event(0, bus="can1"), event(0, id=0x200)], 3),
        ([event(0, source="left"), event(0, id=0x205, source="left")], 1),
        # Only Motor Data has a name.
        ([event(0, source="left"), event(0, id=0x200, flag="hot"), event(0, id=0x201, flag="hot")], 2),
        # The raised one was not let through.
        ([cleared(5)], 1),
    ],
)
def test_incidents(rows, count):
    assert faults_in(table(rows, columns_of(FIELDS, "events"))) == count


def test_the_columns_are_those_that_the_plugin_describes():
    """With type, unit and meaning; what nobody describes comes as JSON in `other`."""
    own = {"name": "jitter", "type": "seconds", "unit": "s", "title": "x", "help": "how the gaps differ"}
    described = FIELDS["statistics"]["summary"]["columns"]
    columns = columns_of({"statistics": {"summary": {"columns": [*described, own]}}}, "summary")
    assert columns.names[:5] == ["bus", "id", "source", "controller", "message"]
    assert columns.names[-2:] == ["jitter", "other"]
    about = columns.field("jitter").metadata
    assert (about[b"title"], about[b"unit"]) == (b"how the gaps differ", b"s")
    record = {"source": "left", "count": 3, "jitter": Decimal("0.25"), "strange": 7, "values": {}}
    (row,) = table([record], columns).to_pylist()
    assert (row["controller"], row["count"], row["jitter"], row["other"]) == ("left", 3, 0.25, '{"strange": 7}')
