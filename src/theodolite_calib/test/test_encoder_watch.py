"""Encoders at rest, in doubt, stuck, in degrees: told from one another by their own motion and the lights."""

import numpy as np

from ship_estimation.refusals import Reason, Refusal
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_geometry.vector_track import VectorTrack
from theodolite_calib.measured.encoder_watch import EncoderWatch
from theodolite_calib.measured.samples import EncoderSample

PERIOD_NS = 10_000_000
FREE = 1e9
"""A mount without mass, rad/s²."""


def reading(number: int, azimuth: float, elevation: float = 0.5) -> EncoderSample:
    return EncoderSample(number * PERIOD_NS, np.array([azimuth, elevation]), ARCSEC)


def check(watch: EncoderWatch, sample: EncoderSample) -> Refusal | None:
    return watch.judge(sample, VectorTrack(PERIOD_NS)).refusal


def lights(watch: EncoderWatch, number: int, azimuth: float) -> None:
    watch.see_lights(number * PERIOD_NS, rotation_from_angles(azimuth, 0.5, 0.0), 3.0 * ARCSEC)


def stopped(rate: float = 0.02) -> tuple[EncoderWatch, int]:
    """Ten readings in motion, rad/s, and one like the last."""
    watch = EncoderWatch(ARCSEC, FREE)
    for number in range(10):
        assert check(watch, reading(number, 1.0 + rate * number * 0.01)) is None
        assert not watch.doubt
    check(watch, reading(10, 1.0 + rate * 0.09))
    return watch, 10


def test_readings_that_stop_dead_are_in_doubt_until_lights_confirm_them() -> None:
    watch, number = stopped()
    assert watch.doubt
    watch.confirm((number - 3) * PERIOD_NS)  # of before they stood still
    assert watch.doubt
    watch.confirm((number + 1) * PERIOD_NS)
    assert not watch.doubt


def test_readings_that_come_to_rest_slowly_are_not_in_doubt() -> None:
    watch, _ = stopped(rate=4.0 * ARCSEC / 0.01)  # less than five sigmas a reading
    assert not watch.doubt


def test_motion_across_the_wrap_is_no_jump() -> None:
    watch = EncoderWatch(ARCSEC, FREE)
    for number, azimuth in enumerate([2 * np.pi - 1e-4, 2 * np.pi - 5e-5, 1e-9, 1e-9 + 1e-6]):
        assert check(watch, reading(number, azimuth)) is None
    assert not watch.doubt


def test_a_mount_at_rest_is_never_stuck() -> None:
    watch, number = stopped()
    for later in range(number + 1, number + 200):
        assert check(watch, reading(later, 1.0 + 0.02 * 0.09)) is None
        if later % 10 == 0:
            lights(watch, later, 1.0 + 0.02 * 0.09)


def test_what_lights_said_before_it_stood_still_is_no_witness() -> None:
    watch = EncoderWatch(ARCSEC, FREE)
    for number in range(10):
        check(watch, reading(number, 1.0 + 0.01 * number))
    # The light of 5 is heard of only now; meanwhile the mount has come to rest.
    lights(watch, 5, 1.05)
    for number in range(10, 60):
        assert check(watch, reading(number, 1.09)) is None
        if number == 30:
            lights(watch, number, 1.09)


def test_mend_03_stuck_when_the_lights_turn_and_back_with_the_first_other_reading() -> None:
    watch, number = stopped()
    refusals = []
    for later in range(number + 1, number + 60):
        lights(watch, later, 1.0 + 0.001 * later)
        refusals.append(check(watch, reading(later, 1.0 + 0.02 * 0.09)))
    # Half a second is not judged: that of the last reading that moved, the one after it, and forty-eight of these.
    assert [r is not None for r in refusals] == [False] * 48 + [True] * 11
    assert refusals[-1].reason is Reason.STUCK
    assert [check(watch, reading(number + 60 + k, 1.1 + 0.001 * k)) for k in range(25)] == [None] * 25


def test_one_reading_beyond_a_turn_is_refused_alone_a_run_of_them_for_good() -> None:
    watch = EncoderWatch(ARCSEC, FREE)
    assert check(watch, reading(0, 6.2)) is None
    assert check(watch, reading(1, 355.0)).reason is Reason.UNITS
    assert check(watch, reading(2, 6.2)) is None
    for number in range(3, 23):
        assert check(watch, reading(number, 355.0)).reason is Reason.UNITS
    refusal = check(watch, reading(30, 4.0, 1.0))
    assert refusal.reason is Reason.UNITS
    assert refusal.text.endswith("refused until a reset")
    # Plunged, the elevation goes up to three quarters of a turn.
    assert check(EncoderWatch(ARCSEC, FREE), reading(0, 1.0, 4.7)) is None
