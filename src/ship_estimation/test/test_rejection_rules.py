"""Conflicts of stamps: without a conflict the record is empty, also after two publishers were recorded and removed."""

from ship_estimation.rejection_rules import Reason, Rejection, StampConflicts
from ship_geometry.earth.time_scales import SECOND_NS

CONFLICT = Rejection(Reason.CONFLICT, "the same stamp with other content")


def test_two_publishers_alone_are_a_conflict_until_one_ends() -> None:
    conflicts = StampConflicts()
    assert conflicts.is_empty
    conflicts.set_duplicate_publishers("ins", 20 * SECOND_NS, "two publishers send on ins/imu")
    assert not conflicts.is_empty
    assert conflicts.active_at(30 * SECOND_NS) == {"ins": 18 * SECOND_NS}
    conflicts.reset()
    assert not conflicts.is_empty
    conflicts.set_duplicate_publishers("ins", 40 * SECOND_NS, "")
    assert conflicts.is_empty
    assert conflicts.active_at(41 * SECOND_NS) == {}


def test_a_conflict_ends_ten_seconds_after_the_last_and_two_publishers_do_not_end_with_it() -> None:
    conflicts = StampConflicts()
    conflicts.record("ship", 5 * SECOND_NS, CONFLICT)
    conflicts.set_duplicate_publishers("ins", 6 * SECOND_NS, "two publishers send on ins/imu")
    assert conflicts.active_at(15 * SECOND_NS).keys() == {"ship", "ins"}
    assert conflicts.active_at(16 * SECOND_NS).keys() == {"ins"}
    conflicts.set_duplicate_publishers("ins", 16 * SECOND_NS, "")
    assert conflicts.active_at(16 * SECOND_NS) == {}
