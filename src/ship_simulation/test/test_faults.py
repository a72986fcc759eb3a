"""Effects of faults on the messages of one topic: inside their window, and nowhere else."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ship_bags.message_store import RosbagsFactory, serialize
from ship_bags.stamps import ns_from_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario import Fault
from ship_simulation.scenario.scenario_file import load_scenario

PAPER = Path(__file__).resolve().parents[3] / "bags" / "scenarios" / "paper.yaml"
FORE = "star/fore/horizon_attitude"


def entries_under(faults, topic):
    """Return the messages of one topic with their log times, from a run of three seconds with an INS of 20 Hz."""
    scenario = load_scenario(PAPER)
    ins = dataclasses.replace(scenario.ins, rate_hz=20.0)
    run = simulate(dataclasses.replace(scenario, duration_s=3.0, ins=ins, faults=faults), seed=1)
    return [(message, log) for name, message, log in generate_messages([run], RosbagsFactory()) if name == topic]


def quaternion(message):
    q = message.orientation
    return np.array([q.x, q.y, q.z, q.w])


def vector(value):
    return np.array([value.x, value.y, value.z])


def faulty(topic, kind, **changes):
    """Return the entries of a topic from two runs: without a fault, and with a fault from 1 s to 2 s."""
    clean = entries_under({}, topic)
    fault = Fault(topic=topic, kind=kind, start_s=1.0, end_s=2.0, **changes)
    return clean, entries_under({"fault": fault}, topic)


def in_window(entries, run_start_ns=1_404_906_607_800_000_000):
    """Return the messages, without log times, that are stamped from 1 s to 2 s after the start."""
    stamped = [(ns_from_stamp(m.header.stamp) - run_start_ns, m) for m, _ in entries]
    return [m for t, m in stamped if SECOND_NS <= t < 2 * SECOND_NS]


def are_equal(first, second):
    return serialize(first) == serialize(second)


def test_drop_keeps_the_other_messages_unchanged():
    clean, changed = faulty(FORE, "drop")
    assert len(clean) - len(changed) == 5
    assert in_window(changed) == []
    left = [log for m, log in clean if not any(m is w for w in in_window(clean))]
    assert [log for _, log in changed] == left


def test_delay_keeps_the_stamp_and_shifts_the_arrival():
    clean, late = faulty(FORE, "delay", delay_s=0.5)
    window = [serialize(m) for m in in_window(clean)]
    delays = [(log - ns_from_stamp(m.header.stamp)) / SECOND_NS for m, log in late if serialize(m) in window]
    assert delays == pytest.approx([0.6] * 5)
    logs = [log for _, log in late]
    assert logs == sorted(logs)


def test_duplicate_repeats_the_bytes():
    clean, doubled = faulty("ins/imu", "duplicate")
    assert len(doubled) - len(clean) == 20
    window = in_window(doubled)
    assert len(window) == 40
    assert all(are_equal(first, second) for first, second in zip(window[::2], window[1::2], strict=True))


def test_conflict_repeats_the_stamp_with_other_values():
    _, doubled = faulty(FORE, "conflict")
    window = in_window(doubled)
    assert len(window) == 10
    for first, second in zip(window[::2], window[1::2], strict=True):
        assert first.header.stamp == second.header.stamp
        assert first.azimuth != second.azimuth


def test_freeze_keeps_the_values_under_new_stamps():
    clean, frozen = faulty("ins/imu", "freeze")
    window = in_window(frozen)
    assert len(window) == len(in_window(clean)) == 20
    first = quaternion(in_window(clean)[0])
    assert all(np.array_equal(quaternion(m), first) for m in window)
    assert len({ns_from_stamp(m.header.stamp) for m in window}) == 20
    after = [m for m, _ in frozen][-1]
    assert are_equal(after, clean[-1][0])


@pytest.mark.parametrize(
    ("topic", "kind", "differs"),
    [
        ("ins/imu", "nan", lambda m: np.isnan(m.orientation.x)),
        (FORE, "nan", lambda m: np.isnan(m.azimuth)),
        ("gnss/fix", "nan", lambda m: np.isnan(m.latitude)),
        ("ins/imu", "frame", lambda m: m.header.frame_id == "ins_other"),
        ("ins/imu", "covariance_unknown", lambda m: not m.orientation_covariance.any()),
        (FORE, "covariance_unknown", lambda m: not (m.covariance.any() or m.rotation_covariance.any())),
        ("ins/imu", "covariance_negative", lambda m: m.orientation_covariance[4] < 0.0 < m.orientation_covariance[0]),
        (FORE, "covariance_negative", lambda m: m.noise_covariance[4] < 0.0 and m.rotation_covariance[4] < 0.0),
    ],
)
def test_a_field_fault_is_limited_to_its_window(topic, kind, differs):
    clean, changed = faulty(topic, kind)
    assert len(clean) == len(changed)
    window = in_window(changed)
    assert window
    assert all(differs(m) for m in window)
    outside = [(a, b) for (a, _), (b, _) in zip(clean, changed, strict=True) if not any(b is w for w in window)]
    assert len(outside) == len(clean) - len(window)
    assert all(are_equal(a, b) and not differs(b) for a, b in outside)


def test_rates_in_degrees_are_larger_by_57():
    clean, changed = faulty("ins/imu", "rate_in_degrees")
    for before, after in zip(in_window(clean), in_window(changed), strict=True):
        expected = np.rad2deg(vector(before.angular_velocity))
        np.testing.assert_allclose(vector(after.angular_velocity), expected, rtol=1e-12)


def test_a_stamp_of_zero_keeps_its_values():
    clean, changed = faulty(FORE, "stamp_zero")
    zero = [m for m, _ in changed if ns_from_stamp(m.header.stamp) == 0]
    assert [m.azimuth for m in zero] == [m.azimuth for m in in_window(clean)]


def test_two_faults_of_one_topic_are_both_applied():
    faults = {
        "first": Fault(topic="ins/imu", kind="frame", start_s=1.0, end_s=2.0),
        "second": Fault(topic="ins/imu", kind="rate_in_degrees", start_s=1.5, end_s=2.5),
    }
    both = in_window(entries_under(faults, "ins/imu"))
    clean = in_window(entries_under({}, "ins/imu"))
    assert all(m.header.frame_id == "ins_other" for m in both)
    pairs = [(vector(a.angular_velocity), vector(b.angular_velocity)) for a, b in zip(clean, both, strict=True)]
    larger = [not np.allclose(before, after) for before, after in pairs]
    assert larger == [False] * 10 + [True] * 10
