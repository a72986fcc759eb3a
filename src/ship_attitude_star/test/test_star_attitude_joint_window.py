"""Grouping of exposures for joint solutions."""

from dataclasses import dataclass

import pytest

from ship_attitude_star.star_attitude.config import JointConfig
from ship_attitude_star.star_attitude.core import JointWindow

MS = 1_000_000


@dataclass(frozen=True)
class Item:
    source: str
    time_ms: int

    @property
    def time_ns(self) -> int:
        return self.time_ms * MS


def groups_of(
    *items: tuple[str, int], movable: bool = True, now_ms: int | None = None, sources: str = "abc"
) -> list[str]:
    """Return groups as ``"a0 b50"``; the window is evaluated after each item is added."""
    window = JointWindow(sources, JointConfig(window_s=0.1, simultaneous_s=0.001, wait_s=0.5))
    groups = []
    for source, time_ms in items:
        assert window.add(Item(source, time_ms))
        groups += list(window.complete_groups(lambda to_ns, from_ns: movable, None))
    groups += list(window.complete_groups(lambda to_ns, from_ns: movable, None if now_ms is None else now_ms * MS))
    return [" ".join(f"{item.source}{item.time_ms}" for item in group) for group in groups]


def test_all_sensors_within_the_window_close_it_at_once() -> None:
    assert groups_of(("a", 0), ("c", 100), ("b", 50)) == ["a0 b50 c100"]


def test_what_is_beyond_the_window_begins_a_new_one() -> None:
    assert groups_of(("a", 0), ("b", 50), ("c", 101)) == ["a0 b50"]
    assert groups_of(("a", 0), ("b", 50), ("c", 101), ("a", 150), ("b", 201)) == ["a0 b50", "c101 a150 b201"]


def test_it_waits_for_a_sensor_without_a_later_exposure() -> None:
    items = [("a", 0), ("b", 50)]
    assert groups_of(*items) == []
    assert groups_of(*items, now_ms=499) == []
    assert groups_of(*items, now_ms=500) == ["a0 b50"]
    assert groups_of(*items, ("a", 200), ("b", 250), now_ms=699) == ["a0 b50"]
    assert groups_of(*items, ("a", 200), ("b", 250), now_ms=700) == ["a0 b50", "a200 b250"]


def test_a_late_exposure_joins_its_group_while_that_is_incomplete() -> None:
    assert groups_of(("b", 50), ("c", 60), ("a", 0)) == ["a0 b50 c60"]


def test_each_exposure_has_a_part_in_one_group_only() -> None:
    # a is twice as fast as b.
    groups = groups_of(("a", 0), ("b", 30), ("a", 50), ("a", 100), ("b", 130), ("a", 150), now_ms=900, sources="ab")
    assert groups == ["a0 b30", "a50 b130", "a100", "a150"]


def test_without_known_rotations_only_simultaneous_exposures_are_joined() -> None:
    assert groups_of(("a", 0), ("b", 1), ("c", 2), movable=False, now_ms=900) == ["a0 b1", "c2"]


@pytest.mark.parametrize("time_ms", [0, -50])
def test_an_exposure_after_its_group_was_completed_is_not_joined(time_ms: int) -> None:
    window = JointWindow("ab", JointConfig(window_s=0.1))
    assert window.add(Item("a", 0))
    assert len(list(window.complete_groups(lambda to_ns, from_ns: True, 500 * MS))) == 1
    assert not window.add(Item("b", time_ms))
    assert window.add(Item("b", 1))
