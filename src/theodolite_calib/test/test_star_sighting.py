"""Samples of a star exposure: streaks are reduced to mid-exposure by the motion of encoders and ship; gaps are
named."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.rejection_rules import Reason, Rejection
from ship_geometry.earth.star_directions import fixed_stars
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_stars.attitude_from_stars.exposure import ExposureLength, StarExposure
from ship_testing.mount_stars import CAMERA_ID, mount_config
from theodolite_calib.samples.samples import EncoderSample, ShipSample
from theodolite_calib.samples.sighting import StarSighting, star_sighting
from theodolite_calib.samples.tracks import MeasuredTracks

SETTINGS = mount_config()
CAMERA = SETTINGS.telescopes[CAMERA_ID].camera.camera("camera")
SECOND_NS, MIDDLE_NS, STEP_NS = 1_000_000_000, 2_000_000_000, 10_000_000
SEEN_S = np.array([[1.0, 0.05, -0.04], [1.0, -0.06, 0.03], [1.0, 0.01, 0.06]])
SEEN_S /= np.linalg.norm(SEEN_S, axis=-1, keepdims=True)


def encoder_angles(time_s: float) -> FloatArray:
    """Return encoder angles as of a telescope that is moved by hand, rad."""
    azimuth_deg, elevation_deg = 10.0 * np.sin(2.0 * np.pi * time_s / 6.0), 5.0 * np.cos(2.0 * np.pi * time_s / 5.0)
    return np.deg2rad([30.0 + azimuth_deg, 40.0 + elevation_deg])


def ship_attitude(time_s: float) -> FloatArray:
    return rotation_from_angles(0.3, np.deg2rad(2.0) * np.sin(time_s), np.deg2rad(6.0) * np.sin(0.7 * time_s))


def camera_attitude(time_s: float) -> FloatArray:
    rotation_dm = main_axis_rotation(AxisErrors(), *encoder_angles(time_s).tolist())
    return ship_attitude(time_s) @ rotation_dm @ rotation_from_angles(*SETTINGS.telescopes[CAMERA_ID].parallelism).T


def tracks(until_s: float = 4.0) -> MeasuredTracks:
    found = MeasuredTracks(SETTINGS)
    for time_ns in range(0, round(until_s * SECOND_NS) + 1, STEP_NS):
        time_s = time_ns / SECOND_NS
        found.encoder.insert(EncoderSample(time_ns, encoder_angles(time_s), 0.05 * ARCSEC))
        found.ship.insert(ShipSample(time_ns, ship_attitude(time_s)))
    return found


def exposure(exposure_s: float) -> StarExposure:
    """Return an exposure of stars, each at the mean of its pixels over a thousand times."""
    seen_n = SEEN_S @ camera_attitude(MIDDLE_NS / SECOND_NS).T
    times_s = MIDDLE_NS / SECOND_NS + exposure_s * ((np.arange(1000) + 0.5) / 1000 - 0.5)
    pixels = np.mean([CAMERA.pixels(seen_n @ camera_attitude(time_s)) for time_s in times_s], axis=0)
    unknown = np.full(len(SEEN_S), np.nan)
    return StarExposure(
        source=f"star.{CAMERA_ID}",
        time_ns=MIDDLE_NS,
        hip=np.zeros(len(SEEN_S), dtype=np.int64),
        directions_s=CAMERA.directions(pixels),
        sigma=np.full(len(SEEN_S), 1.34 * ARCSEC),
        positions=fixed_stars(unknown, unknown),
        position_sigma=np.zeros(len(SEEN_S)),
        magnitude=unknown,
        length=ExposureLength(exposure_s, CAMERA, 0.8),
    )


@pytest.mark.parametrize(("exposure_s", "least_arcsec"), [(0.05, 2.0), (0.2, 30.0)])
def test_streaks_are_brought_to_the_middle_by_encoders_and_ship(exposure_s: float, least_arcsec: float) -> None:
    seen = exposure(exposure_s)
    sighting = star_sighting(seen, SETTINGS, tracks())
    assert isinstance(sighting, StarSighting)
    off, left = (
        np.linalg.norm(found.directions_s - SEEN_S, axis=-1) / ARCSEC for found in (seen, sighting.exposure)
    )
    assert np.max(off) > least_arcsec
    assert np.max(left) < 0.02 * np.max(off)
    # The light is spread along the streak of length L: relative to a star at rest, the variance grows by L²/12 / (0.8
    # px)².
    seen_n = camera_attitude(2.0) @ SEEN_S[0]
    streak = np.linalg.norm(seen_n @ camera_attitude(2.01) - seen_n @ camera_attitude(1.99)) / 0.02 * exposure_s
    assert sighting.exposure.smear_s is not None
    expected = (1.34 * ARCSEC) ** 2 * streak**2 / 12.0 / (0.8 * 6.5e-5) ** 2
    assert np.trace(sighting.exposure.smear_s[0]) == pytest.approx(expected, rel=0.05)


def test_stars_without_exposure_length_are_unchanged() -> None:
    seen = replace(exposure(0.05), length=None)
    sighting = star_sighting(seen, SETTINGS, tracks())
    assert isinstance(sighting, StarSighting)
    np.testing.assert_array_equal(sighting.exposure.directions_s, seen.directions_s)
    assert sighting.camera_id == CAMERA_ID


@pytest.mark.parametrize(
    ("until_s", "text"), [(1.9, "on both sides of the exposure"), (2.05, "over the whole exposure of 0.2 s")]
)
def test_a_gap_is_named(until_s: float, text: str) -> None:
    found = star_sighting(exposure(0.2), SETTINGS, tracks(until_s))
    assert isinstance(found, Rejection)
    assert found.reason is Reason.GAP
    assert text in found.text
