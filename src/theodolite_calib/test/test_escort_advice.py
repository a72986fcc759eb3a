"""Advised positions against a grid, [W18]'s geometry and random limits; their accuracy."""

from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
import pytest

from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.image import Camera, Image
from ship_geometry.mount.line_of_sight import BeaconPoses, LeverArm, Ship, Survey, lines_of_sight
from ship_geometry.rotations import ARCSEC, FloatArray
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.escort.accuracy import BeaconAccuracy
from theodolite_calib.escort.advice import EscortAdvice, advise
from theodolite_calib.filter.filter import CalibrationFilter
from theodolite_calib.filter.telescope_attitude import solve_attitude
from theodolite_calib.samples.tracks import EncoderAt, ShipAt

AZIMUTH, LEVER_M = 1.3, np.array([12.0, 7.0, -3.0])
PAPER_FIELD_DEG = np.array([[3.0, 2.0], [-2.0, -3.0]])
# models.md §5, [W18]: f 100 mm ± 0.1 mm, a tenth of 6.5 µm, 2.7 cm per axis, k of each light 2" at 2 km.
FOCAL_LENGTH_M, FOCAL_SIGMA_M, IMAGE_SIGMA_M, RTK_SIGMA_M, K_SIGMA = 0.1, 1e-4, 0.65e-6, 0.027, 0.0618


def paper_config(names: str = "ab", **limits: Any) -> OpticalAxisConfig:
    """Return a configuration with [W18]'s errors, refraction per beacon, and axes that are nearly unknown."""
    axes = {f"{name}_sigma_arcsec": 3600.0 for name in ("g", "h", "c", "I", "beta_x", "beta_y")}
    lever = dict(zip(("forward_m", "up_m", "right_m"), LEVER_M.tolist(), strict=True))
    values = {
        "telescope": {
            "telescope_id": "t",
            "focal_length_m": FOCAL_LENGTH_M,
            "focal_length_sigma_m": FOCAL_SIGMA_M,
            "sigma_m": IMAGE_SIGMA_M,
        },
        "lever": lever,
        "axes": axes,
        "air": {"sigma": 0.0, "light_sigma": K_SIGMA},
        "ship_antenna": {"sigma_m": 0.0},
        "escort": {"range_max_m": 5000.0, "elevation_min_deg": -5.0, **limits},
        "beacons": {name: {"rtk": {"sigma_m": RTK_SIGMA_M, "bias_sigma_m": 0.0}} for name in names},
    }
    return build(OpticalAxisConfig, values)


def accuracy_of(
    config: OpticalAxisConfig, elevation_deg: float, ship: tuple[float, float, float] = (0.4, 0.0, 0.0)
) -> BeaconAccuracy:
    """Return the accuracy at a ship attitude (heading, pitch, roll, rad) and an encoder elevation."""
    attitude = ShipAt(rotation_from_angles(*ship), np.zeros(3), None, 1e-20)
    encoder = EncoderAt(AZIMUTH, float(np.deg2rad(elevation_deg)), 1e-20)
    return BeaconAccuracy(config, CalibrationFilter(config), attitude, encoder)


def positions_off_axis(accuracy: BeaconAccuracy, angles_deg: FloatArray, range_m: float) -> FloatArray:
    """Return positions at angles (right, up) from the telescope's axis, shape (N, 3)."""
    right, up = np.tan(np.deg2rad(angles_deg)).T
    path = np.column_stack([np.ones_like(up), up, right])
    return accuracy.centre_n + range_m * path / np.linalg.norm(path, axis=1)[:, None] @ accuracy.rotation_nt.T


@pytest.mark.parametrize("elevation_deg", [10.0, 60.0])
def test_accuracy_without_priors_is_that_of_the_beacons(elevation_deg: float) -> None:
    """The accuracy equals that of ``solve_attitude``, and at 10° the bound of models.md §5, 3.47"."""
    accuracy = accuracy_of(paper_config(), elevation_deg)
    places_n = positions_off_axis(accuracy, PAPER_FIELD_DEG, 2000.0)
    camera = Camera(FOCAL_LENGTH_M, FOCAL_SIGMA_M, np.zeros(2))
    none = LeverArm(np.zeros(3), np.zeros(3))
    survey = Survey(none, none, none, np.zeros(3), np.zeros(3), 0.13, 0.0, np.full(2, K_SIGMA))
    noise_n = np.tile(RTK_SIGMA_M**2 * np.eye(3), (2, 1, 1))
    lights = BeaconPoses(places_n - accuracy.centre_n, noise_n, np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3, 3)))
    lines = lines_of_sight(lights, Ship(np.eye(3), np.zeros((3, 3)), np.eye(3)), survey)
    points_m = camera.points(lines.direction_n @ accuracy.rotation_nt)
    covariance_n = solve_attitude(Image(points_m, np.full(2, IMAGE_SIGMA_M)), camera, lines).covariance_n
    axis_n = accuracy.rotation_nt[:, 0]
    expected = np.sqrt(np.trace(covariance_n) - axis_n @ covariance_n @ axis_n)
    found = accuracy.sigma(("a", "b"), places_n)
    assert found == pytest.approx(expected, rel=2e-3)
    if elevation_deg == 10.0:
        assert found / ARCSEC == pytest.approx(3.47, rel=0.01)


def test_budget_is_the_accuracy_by_source() -> None:
    accuracy = accuracy_of(paper_config(exposures=5), 40.0)
    places_n = positions_off_axis(accuracy, PAPER_FIELD_DEG, 1500.0)
    parts = accuracy.budget(("a", "b"), places_n)
    total_n = np.sum(list(parts.values()), axis=0)
    axis_n = accuracy.rotation_nm[:, 0]
    on_sky = np.sqrt(np.trace(total_n) - axis_n @ total_n @ axis_n)
    assert on_sky == pytest.approx(accuracy.sigma(("a", "b"), places_n), rel=1e-9)
    assert {"image", "rtk", "refraction", "axis_errors"} <= parts.keys()


def advice_for(config: OpticalAxisConfig, accuracy: BeaconAccuracy, **now: FloatArray) -> EscortAdvice:
    return advise(config.escort, accuracy, tuple(config.beacons), now)


@pytest.mark.parametrize("elevation_deg", [2.0, 10.0, 30.0])
def test_better_than_the_papers_geometry_at_two_kilometres(elevation_deg: float) -> None:
    """The advice is at least 5 % better than [W18]'s positions, in a field that is no larger.

    The refraction differs from beacon to beacon.
    """
    config = paper_config(field_deg=3.61)
    accuracy = accuracy_of(config, elevation_deg)
    paper_n = positions_off_axis(accuracy, PAPER_FIELD_DEG, 2000.0)
    advice = advice_for(config, accuracy, a=paper_n[0], b=paper_n[1])
    assert advice.sigma_now == accuracy.sigma(("a", "b"), paper_n)
    assert advice.sigma_advised <= 0.95 * advice.sigma_now
    if elevation_deg <= 10.0:
        # The gain is at most about a tenth: the RTK error falls with the distance and the refraction error rises.
        assert advice.sigma_advised >= 0.88 * advice.sigma_now


def grid(accuracy: BeaconAccuracy, config: OpticalAxisConfig) -> FloatArray:
    """Return positions within the limits on a grid of angles from the axis, directions about it, and ranges."""
    limits = config.escort
    off_deg = limits.field_deg * np.array([0.0, 0.5, 0.999])
    ranges_m = np.geomspace(limits.range_min_m, limits.range_max_m, 5)
    found = []
    for off, turn, range_m in product(np.deg2rad(off_deg), np.arange(8) * np.pi / 4.0, ranges_m):
        path = np.array([np.cos(off), np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn)])
        path_n = accuracy.rotation_nt @ path
        elevation_deg = np.rad2deg(np.arcsin(path_n[1]))
        if limits.elevation_min_deg <= elevation_deg <= limits.elevation_max_deg and (off > 0.0 or turn == 0.0):
            found.append(accuracy.centre_n + range_m * path_n)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("elevation_deg", "limits"),
    [
        (10.0, {}),
        (1.0, {"elevation_min_deg": 0.5, "separation_min_m": 150.0}),
        (70.0, {"range_min_m": 300.0, "range_max_m": 1500.0, "field_deg": 2.0}),
        (88.5, {"elevation_max_deg": 89.0, "range_max_m": 2500.0}),
    ],
)
def test_within_two_percent_of_the_best_on_a_grid(elevation_deg: float, limits: dict[str, float]) -> None:
    config = paper_config(**limits)
    accuracy = accuracy_of(config, elevation_deg)
    places_n = grid(accuracy, config)
    assert len(places_n) > 20
    # The drones are equal, so each pair counts once.
    best = min(
        accuracy.sigma(("a", "b"), np.array(pair))
        for pair in combinations_with_replacement(places_n, 2)
        if np.linalg.norm(pair[0] - pair[1]) >= config.escort.separation_min_m
    )
    assert advice_for(config, accuracy).sigma_advised <= 1.02 * best


def test_unlike_drones_get_the_places_that_are_theirs() -> None:
    values = {"telescope": {"telescope_id": "t", "focal_length_m": 0.1, "sigma_m": IMAGE_SIGMA_M}}
    values |= {"escort": {"range_max_m": 5000.0}, "beacons": {"poor": {"rtk": {"sigma_m": 0.2}}, "sharp": {}}}
    config = build(OpticalAxisConfig, values)
    accuracy = accuracy_of(config, 30.0)
    advice = advice_for(config, accuracy)
    assert advice.sigma_advised < accuracy.sigma(advice.names, advice.places_n[::-1])


def random_limits(rng: np.random.Generator) -> tuple[dict[str, float], float]:
    """Return limits that configurations accept, and an elevation of the pointing."""
    range_min_m = float(rng.uniform(50.0, 4000.0))
    range_max_m = float(range_min_m * rng.choice([1.0, rng.uniform(1.0, 10.0)]))
    elevation_min_deg = float(rng.uniform(-5.0, 80.0))
    elevation_max_deg = float(rng.uniform(elevation_min_deg, 90.0))
    field_deg = float(10.0 ** rng.uniform(-1.0, 1.3))
    limits = {
        "range_min_m": range_min_m,
        "range_max_m": range_max_m,
        "separation_min_m": float(rng.uniform(0.0, 2.0) * range_min_m * np.sin(np.deg2rad(field_deg))),
        "elevation_min_deg": elevation_min_deg,
        "elevation_max_deg": elevation_max_deg,
        "field_deg": field_deg,
    }
    near = rng.uniform(elevation_min_deg - 1.2 * field_deg, elevation_max_deg + 1.2 * field_deg)
    return limits, float(np.clip(near, -5.0, 89.5))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_never_outside_the_limits(seed: int) -> None:
    rng, advised = np.random.default_rng(seed), 0
    for _ in range(14):
        limits, elevation_deg = random_limits(rng)
        config = paper_config("abc"[: rng.integers(1, 4)], **limits)
        ship = (float(rng.uniform(0.0, 6.0)), *rng.normal(0.0, 0.02, 2).tolist())
        accuracy = accuracy_of(config, elevation_deg, ship)
        advice = advice_for(config, accuracy)
        if np.isnan(advice.sigma_advised):
            assert np.isnan(advice.places_n).all()
            assert advice.limits_reached[0] in {"elevation_min_deg", "elevation_max_deg", "separation_min_m"}
            continue
        advised += 1
        path_n = advice.places_n - accuracy.centre_n
        range_m = np.linalg.norm(path_n, axis=1)
        elevation = np.rad2deg(np.arcsin(path_n[:, 1] / range_m))
        off_deg = np.rad2deg(np.arccos(path_n @ accuracy.rotation_nt[:, 0] / range_m))
        rounding = 1e-9  # of the arcsine and the arccosine here: a limit may be a single number
        assert np.all((range_m >= limits["range_min_m"] - rounding) & (range_m <= limits["range_max_m"] + rounding))
        assert np.all(elevation >= limits["elevation_min_deg"] - rounding)
        assert np.all(elevation <= limits["elevation_max_deg"] + rounding)
        assert np.all(off_deg <= limits["field_deg"] + rounding)
        for first, second in ((0, 1), (0, 2), (1, 2)):
            if second < len(path_n):
                assert np.linalg.norm(path_n[first] - path_n[second]) >= limits["separation_min_m"]
    assert advised >= 6


def test_limits_reached_are_named() -> None:
    config = paper_config(range_max_m=600.0, separation_min_m=70.0)
    advice = advice_for(config, accuracy_of(config, 20.0))
    # The RTK error falls with the distance, so both drones are advised to go to the maximum range.
    assert {"a: range_max_m", "b: range_max_m"} <= set(advice.limits_reached)
    config = paper_config(range_min_m=500.0, range_max_m=500.0, separation_min_m=61.0, field_deg=3.5)
    advice = advice_for(config, accuracy_of(config, 20.0))
    assert "a, b: separation_min_m" in advice.limits_reached


@pytest.mark.parametrize(
    ("elevation_deg", "limits", "reached"),
    [
        (10.0, {"elevation_min_deg": 20.0}, "elevation_min_deg"),
        (60.0, {"elevation_max_deg": 45.0}, "elevation_max_deg"),
        # Half of the field is below the minimum elevation, and the rest is too narrow for the separation.
        (7.0, {"elevation_min_deg": 10.0, "range_min_m": 1000.0, "range_max_m": 1000.0, "separation_min_m": 120.0},
         "separation_min_m"),
    ],
)  # fmt: skip
def test_missing_position_names_the_limit(elevation_deg: float, limits: dict[str, float], reached: str) -> None:
    config = paper_config(**limits)
    accuracy = accuracy_of(config, elevation_deg)
    advice = advice_for(config, accuracy, a=positions_off_axis(accuracy, PAPER_FIELD_DEG, 1000.0)[0])
    assert np.isnan(advice.places_n).all()
    assert np.isnan(advice.sigma_advised)
    assert advice.limits_reached == (reached,)
    assert np.isfinite(advice.sigma_now)


def test_only_beacons_in_the_field_count() -> None:
    config = paper_config()
    accuracy = accuracy_of(config, 20.0)
    inside_n, outside_n = positions_off_axis(accuracy, np.array([[1.0, 1.0], [4.0, 0.0]]), 1000.0)
    none = advice_for(config, accuracy).sigma_now
    assert none == accuracy.sigma((), np.empty((0, 3)))
    assert advice_for(config, accuracy, a=outside_n).sigma_now == none
    one = advice_for(config, accuracy, a=inside_n, b=outside_n)
    assert one.sigma_now == accuracy.sigma(("a",), inside_n[None])
    assert one.sigma_now < none


@pytest.mark.parametrize("range_max_m", [500.0, 3000.0])
def test_drone_on_deck_is_not_in_the_field(range_max_m: float) -> None:
    config = paper_config(range_max_m=range_max_m)
    accuracy = accuracy_of(config, 20.0)
    on_deck_n = np.tile(accuracy.centre_n, (2, 1))
    advice = advise(config.escort, accuracy, ("a", "b"), dict(zip("ab", on_deck_n, strict=True)), on_deck_n)
    assert advice.sigma_now == accuracy.sigma((), np.empty((0, 3)))
    assert np.isfinite(advice.places_n).all()
    assert advice.sigma_advised <= 1.02 * advice_for(config, accuracy).sigma_advised


def test_places_that_lose_next_to_nothing_are_kept() -> None:
    config = paper_config()
    accuracy = accuracy_of(config, 20.0)
    first = advice_for(config, accuracy)
    flown_n = accuracy.centre_n + 0.98 * (first.places_n - accuracy.centre_n)
    again = advise(config.escort, accuracy, first.names, {}, flown_n)
    np.testing.assert_allclose(again.places_n, flown_n, rtol=0.0, atol=1e-4)
    far_n = accuracy.centre_n + 0.3 * (first.places_n - accuracy.centre_n)
    moved = advise(config.escort, accuracy, first.names, {}, far_n)
    assert moved.sigma_advised <= 1.02 * first.sigma_advised


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ({"range_min_m": 900.0, "range_max_m": 800.0}, "escort.range_min_m' = 900 m: expected at most"),
        ({"elevation_min_deg": 50.0, "elevation_max_deg": 40.0}, "escort.elevation_min_deg"),
        ({"range_max_m": 1000.0, "field_deg": 1.0, "separation_min_m": 1000.0}, "escort.separation_min_m"),
        ({"range_max_m": float("nan")}, "escort.range_max_m' must be finite"),
        ({"field_deg": 0.0}, "escort.field_deg"),
        ({"exposures": 0}, "escort.exposures"),
        ({"period_s": 0.5}, "escort.period_s"),
    ],
)
def test_impossible_limits_are_refused(limits: dict[str, float], named: str) -> None:
    with pytest.raises(ParameterError, match=named):
        paper_config(**limits)


def test_no_escort_without_drones() -> None:
    with pytest.raises(ParameterError, match=r"escort\.enabled"):
        paper_config("", enabled=True)
