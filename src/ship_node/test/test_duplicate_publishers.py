"""Detection of inputs on which two publishers send, by the names of their nodes and by their values."""

import numpy as np

from ship_geometry.rotations import exp_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_node.health.duplicate_publishers import ATTITUDE, WINDOW, DuplicatePublishers

NAMES = "two publishers send on ins/imu: /a and /b; stop all but one"


def add_values(inputs: DuplicatePublishers, first: int, count: int, off_deg: float) -> list[int]:
    """Return the indices of the samples with which the text may have changed; every second sample has an offset."""
    changed = []
    for number in range(first, first + count):
        up = 0.001 * np.sin(0.1 * number) + np.deg2rad(off_deg) * (number % 2)
        sample = AttitudeSample(number * 50_000_000, exp_rotation([0.0, up, 0.0]))
        if inputs.add_value("ins/imu", sample.time_ns, sample):
            changed.append(number)
    return changed


def test_two_streams_and_their_end_are_detected_by_the_values() -> None:
    inputs = DuplicatePublishers({"ins/imu": ATTITUDE})
    assert add_values(inputs, 0, 100, 0.5) == [WINDOW - 1]
    assert inputs.text("ins/imu") == "two streams alternate on ins/imu, 0.5° apart: stop one of its two publishers"
    assert len(add_values(inputs, 100, 100, 0.0)) == 1
    assert inputs.text("ins/imu") == ""


def test_detection_by_values_ends_after_a_timeout_of_both_streams() -> None:
    """Ticks occur each second; both streams end at 5 s."""
    inputs = DuplicatePublishers({"ins/imu": ATTITUDE})
    ended_s = []
    for now_s in range(60):
        if now_s < 5:
            add_values(inputs, 20 * now_s, 20, 0.5)
        ended_s += [now_s] * len(inputs.end_timed_out(now_s * 1_000_000_000))
        assert (inputs.text("ins/imu") != "") is (1 <= now_s < 35)
    assert ended_s == [35]


def test_a_restart_resets_the_value_check_and_keeps_the_names() -> None:
    inputs = DuplicatePublishers({"ins/imu": ATTITUDE})
    add_values(inputs, 0, 100, 0.5)
    inputs.restart()
    assert inputs.text("ins/imu") == ""
    inputs.set_publisher_text("ins/imu", NAMES)
    inputs.restart()
    assert inputs.text("ins/imu") == NAMES


def test_publisher_names_take_precedence_and_reset_the_value_check() -> None:
    inputs = DuplicatePublishers({"ins/imu": ATTITUDE})
    add_values(inputs, 0, 100, 0.5)
    inputs.set_publisher_text("ins/imu", NAMES)
    assert inputs.text("ins/imu") == NAMES
    inputs.set_publisher_text("ins/imu", "")
    assert inputs.text("ins/imu") == ""


def test_an_input_without_continuous_values_uses_names_only() -> None:
    inputs = DuplicatePublishers({})
    assert add_values(inputs, 0, 100, 0.5) == []
    inputs.set_publisher_text("theodolite/beacons", NAMES)
    assert inputs.text("theodolite/beacons") == NAMES
    inputs.set_publisher_text("theodolite/beacons", "")
    assert inputs.text("theodolite/beacons") == ""
