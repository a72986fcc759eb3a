"""Safety of the whole suite: the worst of all angles, with its shortest reason."""

from dataclasses import replace

from ship_testing import suite_states
from ship_watch.suite_state import OverallState, Safety

CAUTION = {"safety": Safety.CAUTION, "accuracy_95": 1.0}


def test_all_angles_safe_is_safe_without_a_reason() -> None:
    assert suite_states.suite_state().overall == OverallState(Safety.SAFE, "")


def test_worst_angle_decides() -> None:
    assert suite_states.state_with_two_faults().overall == OverallState(
        Safety.UNSAFE, "no data from encoder (azimuth, elevation)"
    )


def test_shortest_of_several_reasons_is_given() -> None:
    heading = suite_states.angle("heading", reason="no stars for 31 s", **CAUTION)
    roll = suite_states.angle("roll", reason="one star source", **CAUTION)
    assert suite_states.suite_state(heading, roll).overall.text == "one star source (roll)"


def test_reason_of_all_angles_has_no_names() -> None:
    behind = suite_states.suite_state(
        *(suite_states.angle(name, reason="BEHIND", **CAUTION) for name in suite_states.ANGLES)
    )
    assert behind.overall == OverallState(Safety.CAUTION, "BEHIND")


def test_without_an_angle_nothing_is_safe() -> None:
    assert replace(suite_states.suite_state(), angles=()).overall.safety is Safety.UNSAFE


def test_faulty_source_is_named_before_its_consequence() -> None:
    """The cause is named although its text is longer than that of the consequence."""
    heading = suite_states.angle("heading", reason="star.starboard excluded", because_of="star.starboard", **CAUTION)
    roll = suite_states.angle("roll", reason="over the limit", **CAUTION)
    assert suite_states.suite_state(heading, roll).overall.text == "star.starboard excluded (heading)"
