"""Reader of star observations: usable stars, rejected stars, and reported reasons."""

from typing import Any

import numpy as np
import pytest

from ship_bags.message_factory import RosidlFactory
from ship_bags.stamps import make_header
from ship_estimation.rejection_rules import Reason
from ship_geometry.rotations import ARCSEC
from ship_node.messages.field_checks import MessageRejected
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.config import CameraConfig
from ship_stars.messages.star_messages import MAX_STARS, ExposingSensor, star_exposure
from ship_stars.sky.catalogue import hipparcos, julian_year

FACTORY = RosidlFactory()
STAMP_NS = 1_404_906_607_800_000_000
NOW_NS = STAMP_NS + 100_000_000
# 10 µm of 50 mm: a pixel is 41.25″.
CAMERA = StarCamera(0.05, 10e-6, 511.5, 511.5)
CAMERA_CONFIG = CameraConfig(
    focal_length_m=0.05, pixel_pitch_m=10e-6, principal_u_px=511.5, principal_v_px=511.5, centroid_sigma_px=0.08
)
VEGA, DENEB, ALTAIR = 91262, 102098, 97649


def star(catalogue_id: int = VEGA, u: float = 511.5, v: float = 511.5, **fields: float) -> Any:
    given = {"right_ascension": np.nan, "declination": np.nan, "sigma_px": 0.1, "magnitude": np.nan, **fields}
    return FACTORY.make("ship_msgs/msg/StarObservation", catalogue_id=catalogue_id, u=u, v=v, **given)


def observations(*stars: Any, sensor_id: str = "fore", frame_id: str = "star_fore", stamp_ns: int = STAMP_NS) -> Any:
    return FACTORY.make(
        "ship_msgs/msg/StarObservationArray",
        header=make_header(FACTORY, stamp_ns, frame_id),
        sensor_id=sensor_id,
        exposure_s=0.1,
        stars=list(stars),
    )


def read(message: Any, **options: bool) -> Any:
    sensor = ExposingSensor("fore", "star_fore", CAMERA, CAMERA_CONFIG)
    return star_exposure(message, NOW_NS, sensor, hipparcos(), **options)


def read_exposure(message: Any) -> Any:
    """Return the exposure, and the rejected stars."""
    reading = read(message)
    return reading.value, reading.rejected_parts


def test_pixels_become_directions_and_numbers_become_positions() -> None:
    # One degree to the right and half a degree up of the boresight.
    right_px, up_px = np.tan(np.deg2rad([1.0, 0.5])) * 0.05 / 10e-6
    exposure, rejected = read_exposure(
        observations(star(), star(DENEB, 511.5 + right_px, 511.5 - up_px, magnitude=1.3))
    )
    assert rejected == ()
    assert (exposure.source, exposure.time_ns, exposure.hip.tolist()) == ("star.fore", STAMP_NS, [VEGA, DENEB])
    off = np.array([1.0, np.tan(np.deg2rad(0.5)), np.tan(np.deg2rad(1.0))])
    np.testing.assert_allclose(exposure.directions_s, [[1, 0, 0], off / np.linalg.norm(off)], atol=1e-12)
    # On the boresight 0.1 px are 4.1253″; one degree off it a little less, by the cosine.
    np.testing.assert_allclose(exposure.sigma / ARCSEC, 4.12530, rtol=4e-4)
    assert exposure.sigma[1] < exposure.sigma[0]
    # Vega in the Hipparcos catalogue, J2000.0: 18 36 56.336, +38 47 01.28 (SIMBAD).
    assert np.rad2deg(exposure.positions.right_ascension[0]) / 15 == pytest.approx(18.6156489, abs=1e-6)
    assert np.rad2deg(exposure.positions.declination[0]) == pytest.approx(38.783689, abs=1e-5)
    assert exposure.positions.pm_declination[0] / ARCSEC == pytest.approx(0.286, abs=0.001)
    # Position accurate to a milliarcsecond at 1991.25, motion to 0.6 mas a year at most, 23 years later.
    assert 0 < exposure.position_sigma[0] < 0.02 * ARCSEC
    at_stamp = hipparcos().position_sigma_at(hipparcos().rows(np.array([VEGA])), julian_year(STAMP_NS))
    assert exposure.position_sigma[0] == at_stamp[0]
    assert exposure.is_identified.all()
    assert np.isnan(exposure.magnitude[0])
    assert exposure.magnitude[1] == pytest.approx(1.3)


@pytest.mark.parametrize("not_given", [np.nan, 0.0])
def test_without_a_length_an_exposure_is_used_as_it_is(not_given: float) -> None:
    message = observations(star())
    message.exposure_s = not_given
    exposure, rejected = read_exposure(message)
    assert rejected == ()
    assert exposure.length is None
    message.exposure_s = 0.25
    received = read_exposure(message)[0]
    assert (received.length.exposure_s, received.length.psf_sigma_px, received.length.camera) == (0.25, 0.8, CAMERA)
    np.testing.assert_array_equal(received.directions_s, exposure.directions_s)
    # Which of two messages of one stamp is kept must not depend on their order.
    assert received.content() != exposure.content()


@pytest.mark.parametrize(
    ("exposure_s", "reason"),
    [(-0.1, "units"), (10.5, "units"), (50.0, "units"), (np.inf, "non_finite"), (-np.inf, "non_finite")],
)
def test_an_impossible_length_is_rejected(exposure_s: float, reason: str) -> None:
    message = observations(star())
    message.exposure_s = exposure_s
    with pytest.raises(MessageRejected) as caught:
        read_exposure(message)
    assert caught.value.rejection.reason.word == reason
    assert "exposure_s" in caught.value.rejection.text


def test_a_star_without_number_has_the_given_position_or_none() -> None:
    exposure, rejected = read_exposure(
        observations(star(0, right_ascension=1.0, declination=-0.5), star(0, 600.0, 600.0), star(ALTAIR, 100.0))
    )
    assert rejected == ()
    assert exposure.is_identified.tolist() == [True, False, True]
    given = exposure.positions[0]
    assert (given.right_ascension, given.declination, given.pm_declination) == (1.0, -0.5, 0.0)
    assert exposure.position_sigma[0] == pytest.approx(0.05 * ARCSEC)


def test_a_catalogue_star_has_the_catalogue_position_whatever_else_is_given() -> None:
    by_number, _ = read_exposure(observations(star()))
    with_place, rejected = read_exposure(observations(star(right_ascension=4.9, declination=0.7)))
    assert rejected == ()
    assert with_place.content() == by_number.content()


@pytest.mark.parametrize("sigma_px", [0.0, np.nan])
def test_a_centroid_without_sigma_has_the_configured_one(sigma_px: float) -> None:
    message = observations(star(sigma_px=sigma_px))
    exposure, rejected = read_exposure(message)
    assert rejected == ()
    assert exposure.sigma[0] / ARCSEC == pytest.approx(0.08 * 41.2530, rel=1e-5)
    assert not read(message).covariance_known
    assert read(observations(star(), star(DENEB))).covariance_known


def test_no_star_is_an_exposure_too() -> None:
    exposure, rejected = read_exposure(observations())
    assert (len(exposure), rejected) == (0, ())
    assert read(observations()).is_empty
    assert not read(observations(star(u=np.nan))).is_empty


STARS = [
    ("pixel NaN", star(u=np.nan), Reason.NON_FINITE, "pixel (nan, 511.5)"),
    ("pixel infinite", star(v=-np.inf), Reason.NON_FINITE, "-inf"),
    ("pixel far outside", star(u=1e5), Reason.UNITS, "pixel (100000, 511.5) is outside this camera's field of view"),
    ("pixel nonsense", star(v=-1e300), Reason.UNITS, "-1e+300"),
    ("sigma negative", star(sigma_px=-0.1), Reason.BAD_COVARIANCE, "sigma_px -0.1"),
    ("sigma infinite", star(sigma_px=np.inf), Reason.BAD_COVARIANCE, "sigma_px inf"),
    ("sigma too good to be true", star(sigma_px=1e-30), Reason.BAD_COVARIANCE, "expected 0.0001 to 100 px"),
    ("number unknown", star(120_405), Reason.UNKNOWN_STAR, "Hipparcos-2 (117955 stars, HIP 1 to 120404)"),
    ("number absurd", star(2**32 - 1), Reason.UNKNOWN_STAR, "HIP 4294967295 is not"),
    ("right ascension in degrees", star(0, right_ascension=279.2, declination=0.6), Reason.UNITS, "degrees?"),
    ("declination in degrees", star(0, right_ascension=4.8, declination=38.8), Reason.UNITS, "declination 38.8"),
    ("half a place", star(0, right_ascension=4.8), Reason.NON_FINITE, "expected both"),
    ("infinite place", star(0, right_ascension=4.8, declination=np.inf), Reason.NON_FINITE, "inf"),
    ("the same star again", star(DENEB, 300.0, 300.0), Reason.DUPLICATE, "first at pixel (300, 300)"),
    ("the same star elsewhere", star(DENEB, 301.0, 300.0), Reason.CONFLICT, "first at pixel (300, 300)"),
]


@pytest.mark.parametrize(("bad", "reason", "text"), [s[1:] for s in STARS], ids=[s[0] for s in STARS])
def test_a_bad_star_is_rejected_and_the_others_are_as_without_it(bad: Any, reason: Reason, text: str) -> None:
    good = star(DENEB, 300.0, 300.0), star(ALTAIR, 700.0, 200.0)
    exposure, rejected = read_exposure(observations(*good, bad))
    assert exposure.content() == read_exposure(observations(*good))[0].content()
    ((name, rejection),) = rejected
    assert (name, rejection.reason) == ("star 3 of the message", reason)
    assert text in rejection.text


def test_the_same_given_position_twice_counts_once() -> None:
    place = {"right_ascension": 1.0, "declination": 0.5}
    exposure, rejected = read_exposure(observations(star(0, **place), star(0, 520.0, **place), star(0), star(0, 530.0)))
    assert (len(exposure), [name for name, _ in rejected]) == (3, ["star 2 of the message"])


def test_a_rejected_star_is_named_by_its_number_on_request() -> None:
    message = observations(star(DENEB, u=np.nan), star(0, u=np.nan))
    names = [name for name, _ in read(message, named_by_number=True).rejected_parts]
    assert names == [f"HIP {DENEB}", "star 2 of the message"]


@pytest.mark.slow
def test_a_flood_of_stars_is_cut_and_reported_once() -> None:
    exposure, rejected = read_exposure(observations(*(star(0, float(u % 1000), 10.0) for u in range(100_000))))
    assert len(exposure) == MAX_STARS
    ((name, rejection),) = rejected
    assert (name, rejection.reason) == (f"star {MAX_STARS + 1} of the message", Reason.OVERFLOW)
    assert rejection.text == f"100000 stars in one exposure: only the first {MAX_STARS} are used"


WHOLE = [
    ("stamp zero", observations(star(), stamp_ns=0), "bad_stamp", "0 ns"),
    ("from the future", observations(star(), stamp_ns=NOW_NS + 60_000_000), "future", "0.060 s ahead"),
    ("of another sensor", observations(star(), sensor_id="aft"), "unknown_sensor", "'aft': expected 'fore'"),
    ("frame", observations(star(), frame_id="star_aft"), "frame", "'star_aft': expected 'star_fore'"),
]


@pytest.mark.parametrize(("message", "reason", "text"), [w[1:] for w in WHOLE], ids=[w[0] for w in WHOLE])
def test_a_bad_exposure_is_rejected(message: Any, reason: str, text: str) -> None:
    with pytest.raises(MessageRejected) as caught:
        read_exposure(message)
    assert caught.value.rejection.reason.word == reason
    assert text in caught.value.rejection.text
