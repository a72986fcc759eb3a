"""Messages of sensors that observe the real sky: content, effects of faults, reproducible bags."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_bags.message_store import RosbagsFactory, message_store, serialize
from ship_bags.stamps import ns_from_stamp
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC
from ship_simulation.messages.message_stream import generate_messages
from ship_simulation.run import simulate
from ship_simulation.scenario.scenario import Fault
from ship_simulation.simulate_command import write_bag
from ship_testing.paper_stars import paper_stars, with_sensor

OBSERVATIONS, INERTIAL = "star/fore/observations", "star/fore/inertial_attitude"


def entries_of(run, topic):
    """Return pairs (message, log time) of one topic, each message serialised and read back."""
    store = message_store()
    found = [(message, log) for name, message, log in generate_messages([run], RosbagsFactory()) if name == topic]
    return [(store.deserialize_cdr(serialize(message), message.__msgtype__), log) for message, log in found]


def test_an_observation_has_a_number_or_a_direction_or_nothing():
    for identity, number, direction in (
        ({}, True, False),
        ({"direction_given": True}, False, True),
        ({"identified": False}, False, False),
    ):
        run = simulate(with_sensor(paper_stars(duration_s=1.0), **identity), seed=1)
        for message, _ in entries_of(run, OBSERVATIONS):
            for star in message.stars:
                assert bool(star.catalogue_id) == number
                assert np.isfinite(star.right_ascension) == np.isfinite(star.declination) == direction
                assert star.sigma_px == pytest.approx(0.13222, rel=1e-6)


def test_an_inertial_attitude_uses_forward_left_up():
    sensor = {"output": "inertial_attitude", "sigma_forward_arcsec": 60.0, "sigma_right_arcsec": 5.0}
    run = simulate(with_sensor(paper_stars(duration_s=1.0), **sensor), seed=1)
    message, log = entries_of(run, INERTIAL)[3]
    samples = run.stars["fore"]
    assert log - ns_from_stamp(message.header.stamp) == SECOND_NS // 10
    assert (message.sensor_id, message.header.frame_id) == ("fore", "star_fore")
    q = message.orientation
    rotation_if = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    # By hand: columns forward, left, up from forward, up, right.
    forward, up, right = samples.rotation_cv[3].T
    np.testing.assert_allclose(rotation_if, np.stack([forward, -right, up], axis=1), rtol=0.0, atol=1e-14)
    # Sigmas about forward, left, up: 60″, 5″ as about right, 3″.
    expected = np.diag([60.0**2, 5.0**2, 3.0**2]) * ARCSEC**2
    np.testing.assert_allclose(message.covariance.reshape(3, 3), expected, rtol=1e-12)


def in_window(entries, run):
    """Return the messages stamped from 1 s to 2 s after the start."""
    return [m for m, _ in entries if SECOND_NS <= ns_from_stamp(m.header.stamp) - run.start_ns < 2 * SECOND_NS]


def faulty(scenario, topic, kind, **changes):
    """Return the run without a fault, and a topic's entries without and with a fault from 1 s to 2 s."""
    fault = Fault(topic=topic, kind=kind, start_s=1.0, end_s=2.0, **changes)
    clean, changed = simulate(scenario, 1), simulate(dataclasses.replace(scenario, faults={"fault": fault}), 1)
    return clean, entries_of(clean, topic), entries_of(changed, topic)


def inertial_scenario():
    return with_sensor(paper_stars(duration_s=3.0), output="inertial_attitude")


@pytest.mark.parametrize(
    ("topic", "kind", "differs"),
    [
        (OBSERVATIONS, "nan", lambda m: np.isnan(m.stars[0].u) and np.isfinite(m.stars[1].u)),
        (OBSERVATIONS, "frame", lambda m: m.header.frame_id == "star_fore_other"),
        (INERTIAL, "nan", lambda m: np.isnan(m.orientation.x)),
        (INERTIAL, "covariance_unknown", lambda m: not m.covariance.any()),
        (INERTIAL, "covariance_negative", lambda m: m.covariance[4] < 0.0 < m.covariance[0]),
    ],
)
def test_a_field_fault_is_limited_to_its_window(topic, kind, differs):
    scenario = with_sensor(paper_stars(duration_s=3.0)) if topic == OBSERVATIONS else inertial_scenario()
    run, clean, changed = faulty(scenario, topic, kind)
    assert len(clean) == len(changed) == 16
    window = in_window(changed, run)
    assert len(window) == 5
    assert all(differs(m) for m in window)
    outside = [(a, b) for (a, _), (b, _) in zip(clean, changed, strict=True) if not any(b is w for w in window)]
    assert len(outside) == 11
    assert all(serialize(a) == serialize(b) for a, b in outside)


@pytest.mark.parametrize("topic", [OBSERVATIONS, INERTIAL])
def test_messages_are_dropped_delayed_repeated_and_frozen(topic):
    scenario = with_sensor(paper_stars(duration_s=3.0)) if topic == OBSERVATIONS else inertial_scenario()
    run, clean, dropped = faulty(scenario, topic, "drop")
    assert in_window(dropped, run) == []
    assert len(dropped) == len(clean) - 5
    _, _, late = faulty(scenario, topic, "delay", delay_s=0.5)
    assert sorted(log for _, log in late) != sorted(log for _, log in clean)
    _, _, doubled = faulty(scenario, topic, "duplicate")
    pairs = in_window(doubled, run)
    assert len(pairs) == 10
    assert all(serialize(a) == serialize(b) for a, b in zip(pairs[::2], pairs[1::2], strict=True))
    _, _, in_conflict = faulty(scenario, topic, "conflict")
    pairs = in_window(in_conflict, run)
    for a, b in zip(pairs[::2], pairs[1::2], strict=True):
        assert a.header == b.header
        assert serialize(a) != serialize(b)
    _, _, frozen = faulty(scenario, topic, "freeze")
    first, *others = in_window(frozen, run)
    for other in others:
        assert other.header != first.header
        other.header = first.header
        assert serialize(other) == serialize(first)


def test_a_bag_of_stars_repeats_to_the_byte(tmp_path):
    scenario = with_sensor(paper_stars(duration_s=3.0), false_stars=1.0, swapped_probability=0.3)
    for name in ("first", "second"):
        write_bag(scenario, 7, tmp_path / name, b"")
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
