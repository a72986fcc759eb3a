"""The theodolite's smoother against one least-squares solution over all states of all epochs at once, by scipy.

The batch has the measurement equations and the autocorrelation of each error from docs/explanation/theodolite.md. It
shares no line with the filter or the smoother: rotations are scipy's, derivatives are differences.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_estimation.parameters.schema import build
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC
from ship_testing.sparse_least_squares import covariance_of, solve
from theodolite_calib.config import OpticalAxisConfig
from theodolite_calib.samples.samples import (
    BaselineSample,
    DetectedBeacon,
    EncoderSample,
    Exposure,
    Mode,
    PointingEstimate,
    ShipSample,
)
from theodolite_calib.smoothing import SmoothingAxisCore

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
SIGHTED_MS = [*range(6000, 11000, 1000), *range(15000, 20000, 1000)]
SMOOTHED_MS = [ms for ms in range(500, 22000, 1500) if ms not in SIGHTED_MS]
"""Times of the smoothed pointings, ms: before the first lights, between lights, in a gap, and after the last lights."""

SHIP_N = np.array([[9.0, 2.0, 0.0], [2.0, 16.0, -1.0], [0.0, -1.0, 4.0]]) * ARCSEC**2
SHIP_TIME_S, SHIP_WHITE, BENT, BENT_TIME_S = 12.0, 1.0 * ARCSEC, 8.0 * ARCSEC, 20.0
AXES, FOCAL_M, FOCAL_SIGMA_M, TURN, TURN_SIGMA = 20.0 * ARCSEC, 0.1, 2e-5, 60.0 * ARCSEC, 4.0 * ARCSEC
RTK_M, BIAS_M, BIAS_TIME_S, IMAGE_M, ENCODER = 0.02, 0.03, 15.0, 1e-6, 1.5 * ARCSEC
LIGHTS_DEG = {"a": (3.0, 2.0), "b": (-2.0, -3.0)}
DISTANCE_M = 1500.0
CONFIG = build(
    OpticalAxisConfig,
    {
        "ship": {"slow_time_s": SHIP_TIME_S, "white_sigma_arcsec": SHIP_WHITE / ARCSEC},
        "encoder": {"sigma_arcsec": ENCODER / ARCSEC},
        "axes": {f"{name}_sigma_arcsec": AXES / ARCSEC for name in NAMES},
        "deformation": {"sigma_arcsec": BENT / ARCSEC, "time_s": BENT_TIME_S},
        "telescope": {
            "telescope_id": "main",
            "focal_length_m": FOCAL_M,
            "focal_length_sigma_m": FOCAL_SIGMA_M,
            "sigma_m": IMAGE_M,
            **{f"{angle}_arcsec": TURN / ARCSEC for angle in ("azimuth", "elevation", "rotation")},
            **{f"{angle}_sigma_arcsec": TURN_SIGMA / ARCSEC for angle in ("azimuth", "elevation", "rotation")},
        },
        "air": {"coefficient": 0.0, "sigma": 0.0, "light_sigma": 0.0},
        "ship_antenna": {"sigma_m": 0.0},
        "beacons": {
            id_: {"rtk": {"sigma_m": RTK_M, "bias_sigma_m": BIAS_M, "bias_time_s": BIAS_TIME_S}} for id_ in LIGHTS_DEG
        },
    },
)


# -- the geometry, in the axes North, Up, East and forward, up, right -------------------------------------------------


def rotation(vector: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_matrix()


def rotation_about(axis: int, angle: float) -> np.ndarray:
    """Return the elementary rotation of docs/explanation/frames.md: azimuths clockwise, elevations up."""
    return rotation(-angle * np.eye(3)[axis])


def ship_nd(ms: int) -> np.ndarray:
    t_s = ms / 1000.0
    heading, pitch, roll = np.deg2rad([40.0 + np.sin(t_s / 4.0), np.sin(t_s / 1.3), 3.0 * np.sin(t_s / 1.7)])
    return rotation_about(1, heading) @ rotation_about(2, -pitch) @ rotation_about(0, -roll)


def rate_d(ms: int) -> np.ndarray:
    half_ms = 0.1
    return Rotation.from_matrix(ship_nd(ms - half_ms).T @ ship_nd(ms + half_ms)).as_rotvec() / (2e-3 * half_ms)


def encoders(ms: int) -> np.ndarray:
    return np.deg2rad([8.0 * ms / 1000.0, 40.0 + 25.0 * np.sin(ms / 6000.0)])


def main_dm(axes: np.ndarray, angles: np.ndarray) -> np.ndarray:
    g, h, c, tilt, beta_x, beta_y, flexure = axes
    azimuth, elevation = angles
    raised = elevation - h + flexure * np.cos(elevation)
    vertical = rotation(np.array([beta_y, 0.0, -beta_x]))
    return (
        vertical
        @ rotation_about(1, azimuth - g)
        @ rotation_about(0, tilt)
        @ rotation_about(2, -raised)
        @ rotation_about(1, -c)
    )


def main_nm(ship: np.ndarray, bent: np.ndarray, axes: np.ndarray, angles: np.ndarray, ms: int) -> np.ndarray:
    return rotation(ship) @ ship_nd(ms) @ rotation(bent) @ main_dm(axes, angles)


def telescope_tm(parallelism: np.ndarray) -> np.ndarray:
    azimuth, elevation, rotation = parallelism
    return rotation_about(1, azimuth) @ rotation_about(2, -elevation) @ rotation_about(0, -rotation)


def point_m(direction: np.ndarray, focal_m: float) -> np.ndarray:
    """Return the point (right, up) of a direction (forward, up, right) on the detector, where the image is inverted."""
    return -focal_m * direction[[2, 1]] / direction[0]


# -- what is measured -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SimulatedSighting:
    """One beacon at one time: baseline and detector point."""

    ms: int
    id_: str
    baseline_n: np.ndarray
    point_m: np.ndarray


def simulate_sightings() -> list[SimulatedSighting]:
    """Return sightings with errors of about the stated sizes; both estimators must agree for any errors."""
    rng, found = np.random.default_rng(5), []
    axes, parallelism = AXES * rng.standard_normal(7), TURN + TURN_SIGMA * rng.standard_normal(3)
    for ms in SIGHTED_MS:
        slow = np.linalg.cholesky(SHIP_N) @ np.array([0.7, -0.9, 1.0]) * np.cos(ms / 9000.0)
        bent = BENT * np.array([1.0, 0.4, -0.8]) * np.sin(ms / 11000.0)
        angles = encoders(ms) + ENCODER * rng.standard_normal(2)
        rotation_nm = rotation(SHIP_WHITE * rng.standard_normal(3)) @ main_nm(slow, bent, axes, angles, ms)
        rotation_nt = rotation_nm @ telescope_tm(parallelism).T
        for id_, (right_deg, up_deg) in LIGHTS_DEG.items():
            seen_t = (
                rotation_about(1, np.deg2rad(right_deg))
                @ rotation_about(2, -np.deg2rad(up_deg))
                @ np.array([1.0, 0.0, 0.0])
            )
            baseline_n = DISTANCE_M * rotation_nt @ seen_t + np.hypot(RTK_M, BIAS_M) * rng.standard_normal(3)
            at_m = point_m(seen_t, FOCAL_M + 0.5 * FOCAL_SIGMA_M) + IMAGE_M * rng.standard_normal(2)
            found.append(SimulatedSighting(ms, id_, baseline_n, at_m))
    return found


def run_smoother() -> tuple[SmoothingAxisCore, list[PointingEstimate], list[PointingEstimate]]:
    """Run the core in the order of stamps; return real-time and smoothed pointings at the requested times."""
    core, at_once, lights = SmoothingAxisCore(CONFIG), [], simulate_sightings()
    for ms in range(0, 22000, 250):
        time_ns = START_NS + ms * 1_000_000
        core.pointings.add_ship(ShipSample(time_ns, ship_nd(ms), rate_d(ms), SHIP_N))
        here = [light for light in lights if light.ms == ms]
        for light in here:
            core.streams.add_baseline(light.id_, BaselineSample(time_ns, light.baseline_n, RTK_M**2 * np.eye(3)))
        if here:
            seen = tuple(DetectedBeacon(light.id_, light.point_m, IMAGE_M) for light in here)
            core.add_exposure(Exposure(time_ns, seen))
        at_once += core.pointings.add_encoder(EncoderSample(time_ns, encoders(ms), ENCODER)).estimates
    assert core.state.sighting_count == len(SIGHTED_MS)
    smoothed_ns = {START_NS + ms * 1_000_000 for ms in SMOOTHED_MS}
    again = list(core.smooth_remaining())
    assert [one.time_ns for one in again] == [one.time_ns for one in at_once]
    return core, *([one for one in estimates if one.time_ns in smoothed_ns] for estimates in (at_once, again))


# -- the batch --------------------------------------------------------------------------------------------------------


@dataclass
class Batch:
    """All unknowns by name, and all residuals of unit variance with the unknowns that they depend on."""

    places: dict[tuple[str, int], slice] = field(default_factory=dict)
    rows: list[tuple] = field(default_factory=list)
    size: int = 0

    def add_unknown(self, name: str, ms: int = 0, count: int = 3) -> slice:
        if (name, ms) not in self.places:
            self.places[name, ms] = slice(self.size, self.size + count)
            self.size += count
        return self.places[name, ms]

    def add_prior(self, name: str, sigma: float, ms: int = 0, count: int = 3) -> None:
        self.rows.append(([self.add_unknown(name, ms, count)], lambda value: value / sigma))

    def add_process(self, name: str, epochs: list[int], covariance: np.ndarray, time_s: float) -> None:
        """Add a Gauss-Markov process: its first value, then each value relative to the value before."""
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        self.rows.append(([self.add_unknown(name, epochs[0])], lambda first: root @ first))
        for before, after in pairwise(epochs):
            left = np.exp(-(after - before) / 1000.0 / time_s)
            step = lambda one, two, left=left: root @ (two - left * one) / np.sqrt(1.0 - left**2)  # noqa: E731
            self.rows.append(([self.add_unknown(name, before), self.add_unknown(name, after)], step))


def batch() -> Batch:
    built, three = Batch(), np.eye(3)
    epochs = sorted({*SIGHTED_MS, *SMOOTHED_MS})
    built.add_process("ship", epochs, SHIP_N, SHIP_TIME_S)
    built.add_process("bent", epochs, BENT**2 * three, BENT_TIME_S)
    built.add_prior("axes", AXES, count=7)
    built.add_prior("focal", FOCAL_SIGMA_M, count=1)
    built.add_prior("turn", TURN_SIGMA)
    for id_ in LIGHTS_DEG:
        built.add_process(f"bias {id_}", SIGHTED_MS, BIAS_M**2 * three, BIAS_TIME_S)
    for ms in SIGHTED_MS:
        built.add_prior("white", SHIP_WHITE, ms)
        built.add_prior("read", ENCODER, ms, 2)
    for light in simulate_sightings():
        ms, id_ = light.ms, light.id_
        built.add_prior(f"rtk {id_}", RTK_M, ms)
        names = [("axes", 0), ("focal", 0), ("turn", 0), *((name, ms) for name in ("ship", "bent", "white", "read"))]
        names += [(f"bias {id_}", ms), (f"rtk {id_}", ms)]

        def residual(axes, focal, turn, ship, bent, white, read, bias, rtk, light=light):
            rotation_nm = rotation(white) @ main_nm(ship, bent, axes, encoders(light.ms) + read, light.ms)
            seen_t = telescope_tm(TURN + turn) @ rotation_nm.T @ (light.baseline_n + bias + rtk)
            return (light.point_m - point_m(seen_t, FOCAL_M + focal[0])) / IMAGE_M

        built.rows.append(([built.places[name] for name in names], residual))
    return built


def steps_of(built: Batch) -> np.ndarray:
    """Return the steps of the differences: 1 mm for baselines, 10 nm for the focal length, 1e-7 rad for angles."""
    metres = np.zeros(built.size, dtype=bool)
    for (name, _), place in built.places.items():
        metres[place] = name.startswith(("bias", "rtk"))
    steps = np.where(metres, 1e-3, 1e-7)
    steps[built.places["focal", 0]] = 1e-8
    return steps


@pytest.fixture(scope="module")
def smoother_and_batch() -> tuple:
    built = batch()
    return *run_smoother(), built, *solve(built.rows, steps_of(built))


def test_smoothed_pointings_are_batch_least_squares(smoother_and_batch: tuple) -> None:
    # Requirement: within 1 % of sigma.
    _, at_once, smoothed, built, unknowns, factors = smoother_and_batch
    assert [one.time_ns for one in smoothed] == [START_NS + ms * 1_000_000 for ms in SMOOTHED_MS]
    worst_mean = worst_sigma = 0.0
    for one, ms in zip(smoothed, SMOOTHED_MS, strict=True):
        parts = [built.places["ship", ms], built.places["bent", ms], built.places["axes", 0]]
        at = [unknowns[part] for part in parts]
        rotation_nm = main_nm(*at, encoders(ms), ms)

        def rotation_off(change: np.ndarray, at=at, ms=ms, rotation_nm=rotation_nm) -> np.ndarray:
            ship, bent, axes, read = np.split(change, [3, 6, 13])
            moved = main_nm(at[0] + ship, at[1] + bent, at[2] + axes, encoders(ms) + read, ms)
            return Rotation.from_matrix(moved @ rotation_nm.T).as_rotvec()

        step = 1e-6
        slopes = np.array(
            [(rotation_off(step * unit) - rotation_off(-step * unit)) / (2 * step) for unit in np.eye(15)]
        ).T
        expected = slopes[:, :13] @ covariance_of(factors, built.size, parts) @ slopes[:, :13].T
        expected += ENCODER**2 * slopes[:, 13:] @ slopes[:, 13:].T + SHIP_WHITE**2 * np.eye(3)
        sigma = np.sqrt(expected.diagonal())
        difference = Rotation.from_matrix(one.rotation_nm @ rotation_nm.T).as_rotvec()
        worst_mean = max(worst_mean, np.max(np.abs(difference) / sigma))
        worst_sigma = max(worst_sigma, np.max(np.abs(np.sqrt(one.covariance_n.diagonal()) / sigma - 1.0)))
    print(f"pointings apart by {worst_mean:.5f} sigma, sigmas by {worst_sigma:.5f}")
    assert worst_mean < 0.01
    assert worst_sigma < 0.01
    # Before the first lights, the real-time pointings have only the configured axes.
    gained = np.sqrt(np.trace(smoothed[0].covariance_n) / np.trace(at_once[0].covariance_n))
    assert gained < 0.6
    assert at_once[0].mode == smoothed[0].mode == Mode.ENCODER


def test_the_filters_covariance_is_the_inverse_of_the_information_matrix(smoother_and_batch: tuple) -> None:
    # After the last sighting the filter has used all that the batch has.
    core, _, _, built, unknowns, factors = smoother_and_batch
    last_ms, model, state = SIGHTED_MS[-1], core.filter.model, core.state
    assert state.time_ns == START_NS + last_ms * 1_000_000
    keys = {"ship.attitude": ("ship", last_ms), "deformation": ("bent", last_ms), "axes": ("axes", 0)}
    keys |= {"focal_length": ("focal", 0), "parallelism": ("turn", 0)}
    keys |= {f"light.{id_}.rtk": (f"bias {id_}", last_ms) for id_ in LIGHTS_DEG}
    parts = [built.places[key] for key in keys.values()]
    rows = np.concatenate([model.state_indices(name) for name in keys])
    expected = covariance_of(factors, built.size, parts)
    sigma = np.sqrt(expected.diagonal())
    both_sigmas = np.outer(sigma, sigma)
    mean, found = np.concatenate([unknowns[part] for part in parts]), state.covariance[np.ix_(rows, rows)]
    assert np.max(np.abs(state.mean[rows] - mean) / sigma) < 0.01
    np.testing.assert_allclose(found / both_sigmas, expected / both_sigmas, rtol=0, atol=0.01)
