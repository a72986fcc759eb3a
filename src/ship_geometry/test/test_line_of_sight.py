"""Lines of sight: geometry by hand, Jacobians by differences, joint covariance by random draws."""

from dataclasses import replace

import numpy as np
import pytest

from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.image import block_diagonal
from ship_geometry.mount.line_of_sight import (
    BeaconPoses,
    ErrorTerm,
    LeverArm,
    LinesOfSight,
    Ship,
    Survey,
    covariance_by_source,
    lines_of_sight,
)
from ship_geometry.rotations import ARCSEC, FloatArray, exp_rotation
from ship_testing.simulated_sightings import CAMERA, SURVEY, error_free_epochs, raise_elevation, truth_of

NOTHING = LeverArm(np.zeros(3), np.zeros(3))
# The lights have different distances and heights; levers and errors are large enough for each term to count.
TRUTH = replace(
    truth_of(200.0, 25.0, 10.0, np.array([[3.0, 2.0], [-2.0, -3.0], [1.0, -2.5]])),
    distance_m=np.array([900.0, 2000.0, 1400.0]),
)
BIG = Survey(
    theodolite_lever=LeverArm(np.array([12.0, 3.0, -2.0]), np.array([0.01, 0.02, 0.03])),
    principal_point=LeverArm(np.array([0.4, 0.3, 0.1]), np.array([0.005, 0.01, 0.015])),
    beacon_lever=LeverArm(
        np.array([[0.1, -0.3, 0.05], [0.2, -0.4, 0.0], [0.0, -0.2, 0.3]]), np.array([0.02, 0.01, 0.01])
    ),
    rtk_base_sigma_m=np.array([0.01, 0.03, 0.02]),
    rtk_bias_sigma_m=np.array([0.02, 0.04, 0.01]),
    refraction_coefficient=0.13,
    refraction_sigma=0.06,
    refraction_beacon_sigma=np.array([0.03, 0.05, 0.02]),
)


def inputs() -> tuple[BeaconPoses, Ship, Survey]:
    epoch = error_free_epochs(TRUTH, BIG, CAMERA, seed=4)
    rng = np.random.default_rng(8)
    roots = rng.standard_normal((7, 3, 3))
    covariances = roots @ np.swapaxes(roots, -1, -2)
    lights = replace(
        epoch.beacons, baseline_covariance_n=1e-4 * covariances[:3], attitude_covariance_n=2e-3 * covariances[3:6]
    )
    return lights, replace(epoch.ship, attitude_covariance_n=1e-6 * covariances[6]), BIG


def disturbed_lines(name: str, error: FloatArray, lights: BeaconPoses, ship: Ship, survey: Survey) -> LinesOfSight:
    """Return lines of sight with an error added to the named values; shape (k,) if common, else (N, k)."""

    def with_longer(lever: LeverArm) -> LeverArm:
        return replace(lever, vector_m=lever.vector_m + error)

    match name:
        case "rtk_noise" | "rtk_bias" | "rtk_base":
            lights = replace(lights, baseline_n=lights.baseline_n + error)
        case "theodolite_lever" | "principal_point" | "light_lever":
            lever = name.replace("light", "beacon")
            survey = replace(survey, **{lever: with_longer(getattr(survey, lever))})
        case "ship_attitude":
            ship = replace(ship, rotation_nd=exp_rotation(error) @ ship.rotation_nd)
        case "drone_attitude":
            lights = replace(lights, rotation_nb=exp_rotation(error) @ lights.rotation_nb)
        case "refraction" | "light_refraction":
            survey = replace(survey, refraction_coefficient=survey.refraction_coefficient + error[..., 0])
    return lines_of_sight(lights, ship, survey)


TERMS = {term.name: term for term in lines_of_sight(*inputs()).terms}


def test_a_case_by_hand():
    # A level ship heading East: bow = East, starboard = South. The theodolite is 10 m ahead of the antenna and 2 m
    # higher, its axis looks abeam to port (North), the lens 0.5 m before the crossing of the axes: at N 0.5, U 2, E 10.
    # A drone with its nose to the East carries the light 1 m ahead and 0.25 m below its antenna.
    ship = Ship(rotation_from_angles(np.pi / 2, 0.0, 0.0), np.zeros((3, 3)), rotation_from_angles(-np.pi / 2, 0.0, 0.0))
    lights = BeaconPoses(
        baseline_n=np.array([[1000.0, 300.0, 20.0]]),
        baseline_covariance_n=np.zeros((3, 3)),
        rotation_nb=rotation_from_angles(np.pi / 2, 0.0, 0.0)[None],
        attitude_covariance_n=np.zeros((3, 3)),
    )
    survey = replace(
        SURVEY,
        theodolite_lever=LeverArm(np.array([10.0, 2.0, 0.0]), np.zeros(3)),
        principal_point=LeverArm(np.array([0.5, 0.0, 0.0]), np.zeros(3)),
        beacon_lever=LeverArm(np.array([1.0, -0.25, 0.0]), np.zeros(3)),
        refraction_coefficient=0.0,
    )
    lines = lines_of_sight(lights, ship, survey)
    path_n = np.array([999.5, 297.75, 11.0])
    assert lines.distance_m[0] == pytest.approx(np.linalg.norm(path_n), abs=1e-10)
    assert lines.direction_n[0] == pytest.approx(path_n / np.linalg.norm(path_n), abs=1e-14)


@pytest.mark.parametrize("elevation_deg", [-5.0, 0.0, 30.0, 60.0, 85.0])
def test_refraction_raises_by_k_times_the_horizontal_distance_over_twice_the_radius(elevation_deg):
    direction_n = rotation_from_angles(*np.deg2rad([130.0, elevation_deg, 0.0]))[:, 0]
    lines = bare_lines(2000.0 * direction_n, refraction_coefficient=0.13)
    angle = 0.13 * 2000.0 * np.cos(np.deg2rad(elevation_deg)) / (2.0 * 6_371_000.0)
    assert lines.direction_n[0] == pytest.approx(raise_elevation(direction_n, angle), abs=1e-9)
    if elevation_deg == 0.0:
        # models.md §5: 4.2" at 2 km.
        assert lines.direction_n[0, 1] / ARCSEC == pytest.approx(4.2, abs=0.05)


def test_no_refraction_at_the_zenith():
    lines = bare_lines(np.array([0.0, 2000.0, 0.0]), refraction_coefficient=0.13)
    assert lines.direction_n[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)


def bare_lines(path_n: FloatArray, refraction_coefficient: float) -> LinesOfSight:
    """Return the line of sight of one beacon at the end of its baseline, without levers."""
    lights = BeaconPoses(path_n[None], np.zeros((3, 3)), np.eye(3)[None], np.zeros((3, 3)))
    survey = replace(
        SURVEY,
        theodolite_lever=NOTHING,
        principal_point=NOTHING,
        beacon_lever=NOTHING,
        refraction_coefficient=refraction_coefficient,
    )
    return lines_of_sight(lights, Ship(np.eye(3), np.zeros((3, 3)), np.eye(3)), survey)


def test_simulated_truth_is_met():
    # The simulation goes the other way, from the direction to the baseline, by its own formulas.
    epoch = error_free_epochs(TRUTH, BIG, CAMERA, seed=4)
    angle = 0.13 * TRUTH.distance_m * np.cos(np.arcsin(TRUTH.direction_n[:, 1])) / (2.0 * 6_371_000.0)
    lines = epoch.lines()
    assert lines.direction_n == pytest.approx(raise_elevation(TRUTH.direction_n, angle), abs=1e-9)
    assert lines.distance_m == pytest.approx(TRUTH.distance_m, abs=1e-9)


@pytest.mark.parametrize("name", TERMS)
def test_jacobians_equal_finite_differences(name):
    term, step = TERMS[name], 1e-5
    count, components = term.jacobian_n.shape[-3], term.jacobian_n.shape[-1]
    for k in range(components):
        error = step * np.eye(components)[k]
        if not term.is_common:
            error = np.tile(error, (count, 1))
        more, less = (disturbed_lines(name, sign * error, *inputs()).direction_n for sign in (1.0, -1.0))
        expected = (more - less) / (2.0 * step)
        # The Jacobian neglects the change of the refraction with the path, 4e-5 of the whole.
        largest = np.abs(term.jacobian_n).max()
        assert term.jacobian_n[..., k] == pytest.approx(expected, abs=1e-4 * largest)


def test_own_errors_are_independent_between_beacons():
    for name, term in TERMS.items():
        if term.is_common:
            continue
        error = np.zeros((3, term.jacobian_n.shape[-1]))
        error[1] = 1e-3
        moved = disturbed_lines(name, error, *inputs()).direction_n - lines_of_sight(*inputs()).direction_n
        assert np.abs(moved[[0, 2]]).max() == 0.0
        assert np.abs(moved[1]).max() > 0.0


def test_common_terms_and_sources():
    common = {"rtk_base", "theodolite_lever", "principal_point", "ship_attitude", "refraction"}
    assert {name for name, term in TERMS.items() if term.is_common} == common
    sources = {"rtk", "lever_arms", "ship_attitude", "drone_attitude", "refraction"}
    assert {term.source for term in TERMS.values()} == sources


def test_joint_covariance_is_that_of_drawn_errors():
    """All errors are drawn at once, common errors included, and each is applied where it enters."""
    rng, count = np.random.default_rng(12), 20_000
    lights, ship, survey = inputs()

    def draw(name: str) -> FloatArray:
        term = TERMS[name]
        shape = (count, 1) if term.is_common else (count, 3)
        root = np.linalg.cholesky(term.covariance)
        return (root @ rng.standard_normal((*shape, root.shape[-1], 1)))[..., 0]

    lever = LeverArm(survey.beacon_lever.vector_m + draw("light_lever"), np.zeros(3))
    ahead = survey.theodolite_lever.vector_m + draw("theodolite_lever")[:, 0]
    lens = survey.principal_point.vector_m + draw("principal_point")[:, 0]
    rotation_nd = exp_rotation(draw("ship_attitude")[:, 0]) @ ship.rotation_nd
    # The ship's levers have no dimension for draws, so they are subtracted from the baselines, as in models.md §5.
    rotated = np.einsum("nij,nj->ni", rotation_nd, ahead) + np.einsum(
        "nij,jk,nk->ni", rotation_nd, ship.rotation_dm, lens
    )
    baseline_n = lights.baseline_n + draw("rtk_noise") + draw("rtk_bias") + draw("rtk_base") - rotated[:, None]
    rotation_nb = exp_rotation(draw("drone_attitude")) @ lights.rotation_nb
    coefficient = survey.refraction_coefficient + (draw("refraction") + draw("light_refraction"))[..., 0]
    true = lines_of_sight(
        replace(lights, baseline_n=baseline_n, rotation_nb=rotation_nb),
        replace(ship, rotation_nd=rotation_nd),
        replace(
            survey,
            theodolite_lever=NOTHING,
            principal_point=NOTHING,
            beacon_lever=lever,
            refraction_coefficient=coefficient,
        ),
    )
    used = lines_of_sight(lights, ship, survey)
    error = (true.direction_n - used.direction_n).reshape(count, 9)
    covariance = sum(covariance_by_source(used.terms).values())
    sigma = np.sqrt(np.diag(covariance))
    sample = error.T @ error / count / np.outer(sigma, sigma)
    correlation = covariance / np.outer(sigma, sigma)
    # Four and a half standard deviations for 45 different elements.
    assert np.abs(sample - correlation).max() < 4.5 * np.sqrt(2.0 / count)
    # The errors of different lights are correlated here.
    assert np.abs(correlation[:3, 3:]).max() > 0.2


def test_sources_add_up_their_terms():
    parts = covariance_by_source(TERMS.values())
    assert set(parts) == {"rtk", "lever_arms", "ship_attitude", "drone_attitude", "refraction"}
    expected = sum(
        TERMS[name].direction_covariance_n() for name in ("theodolite_lever", "principal_point", "light_lever")
    )
    assert parts["lever_arms"] == pytest.approx(expected, abs=1e-25)


def test_epochs_at_once_are_epochs_one_by_one():
    epochs = error_free_epochs(truth_of(np.array([[10.0, 100.0], [200.0, 300.0]]), 20.0, 5.0), seed=3)
    together = epochs.lines()
    assert together.direction_n.shape == (2, 2, 2, 3)
    for index in np.ndindex(2, 2):
        alone = lines_of_sight(
            replace(
                epochs.beacons,
                baseline_n=epochs.beacons.baseline_n[index],
                rotation_nb=epochs.beacons.rotation_nb[index],
            ),
            replace(
                epochs.ship, rotation_nd=epochs.ship.rotation_nd[index], rotation_dm=epochs.ship.rotation_dm[index]
            ),
            epochs.survey,
        )
        assert alone.direction_n == pytest.approx(together.direction_n[index], abs=1e-15)
        for one, all_ in zip(alone.terms, together.terms, strict=True):
            assert one.direction_covariance_n() == pytest.approx(all_.direction_covariance_n()[index], abs=1e-25)


def test_block_diagonal():
    blocks = np.arange(12.0).reshape(1, 2, 2, 3)
    expected = [[0, 1, 2, 0, 0, 0], [3, 4, 5, 0, 0, 0], [0, 0, 0, 6, 7, 8], [0, 0, 0, 9, 10, 11]]
    assert block_diagonal(blocks)[0].tolist() == expected


def test_common_error_correlates_the_beacons_fully():
    jacobian_n = np.ones((2, 3, 1))
    term = ErrorTerm("x", "x", is_common=True, jacobian_n=jacobian_n, covariance=np.array([[4.0]]))
    assert term.direction_covariance_n().tolist() == np.full((6, 6), 4.0).tolist()
