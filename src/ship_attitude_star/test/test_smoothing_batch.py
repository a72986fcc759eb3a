"""The smoother compared with one least-squares solution over all states of all epochs, by scipy's sparse solver.

The batch uses the measurement equation and the autocorrelation of each error as in docs/explanation/filter.md. It
shares no code with the filter or the smoother: rotations are scipy's, derivatives are differences.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ship_attitude_star.ship_attitude.config import ShipAttitudeConfig
from ship_attitude_star.smoothing import SmoothingCore
from ship_estimation.parameters.schema import build
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import AttitudeSample
from ship_stars.attitude_samples import AttitudeEstimate, AttitudeMeasurement
from ship_testing.sparse_least_squares import covariance_of, solve

START_NS, SECOND_NS = 1_700_000_000_000_000_000, 1_000_000_000
DURATION_S, INS_PERIOD_S = 24.0, 0.02
TILT, HEADING, TILT_TIME_S, HEADING_TIME_S, WHITE = 6.0 * ARCSEC, 20.0 * ARCSEC, 8.0, 20.0, 0.2 * ARCSEC
MOUNTED, CLOCK_S, COMMON, COMMON_TIME_S, FLEXURE, FLEXURE_TIME_S = 30 * ARCSEC, 0.002, 2 * ARCSEC, 15.0, 2 * ARCSEC, 4.0
NOISE = np.array([40.0, 3.0, 3.0]) * ARCSEC
SENSORS = {"fore": np.deg2rad([0.0, 45.0, 0.0]), "starboard": np.deg2rad([90.0, 40.0, 0.0])}
CONFIG = build(
    ShipAttitudeConfig,
    {
        "ins": {
            "tilt_sigma_arcsec": TILT / ARCSEC,
            "heading_sigma_arcsec": HEADING / ARCSEC,
            "tilt_time_s": TILT_TIME_S,
            "heading_time_s": HEADING_TIME_S,
            "white_sigma_arcsec": WHITE / ARCSEC,
            "time_offset_sigma_s": CLOCK_S,
        },
        "star_sensors": {
            id_: {
                "azimuth_deg": float(np.rad2deg(angles[0])),
                "elevation_deg": float(np.rad2deg(angles[1])),
                "installation_sigma_forward_arcsec": MOUNTED / ARCSEC,
                "installation_sigma_up_arcsec": MOUNTED / ARCSEC,
                "installation_sigma_right_arcsec": MOUNTED / ARCSEC,
                "common_time_s": COMMON_TIME_S,
                "flexure_sigma_arcsec": FLEXURE / ARCSEC if id_ == "fore" else 0.0,
                "flexure_time_s": FLEXURE_TIME_S,
            }
            for id_, angles in SENSORS.items()
        },
    },
)


def ins_nd(t_s: float) -> np.ndarray:
    """Attitude of the INS: a ship that rolls by 3° in 7 s and pitches by 1° in 5 s."""
    heading, pitch, roll = np.array([0.3, 1.0, 3.0]) * np.sin(2 * np.pi * t_s / np.array([25.0, 5.0, 7.0]))
    return rotation_from_angles(*np.deg2rad([40.0 + heading, pitch, roll]))


def rotation_of(vector: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_matrix()


def rate_d(t_s: float) -> np.ndarray:
    half = 1e-4
    return Rotation.from_matrix(ins_nd(t_s - half).T @ ins_nd(t_s + half)).as_rotvec() / (2 * half)


def star_epochs() -> list[tuple[int, str]]:
    """Return stamps in ms and sensors: fore each half second, starboard at every other of these and 260 ms later."""
    fore = [(ms, "fore") for ms in range(1000, int(1000 * DURATION_S) - 1000, 500)]
    starboard = [(ms, "starboard") for ms in range(1500, int(1000 * DURATION_S) - 1000, 1000)]
    return sorted([*fore, *starboard, *((ms + 260, "starboard") for ms, _ in starboard)])


def measurements() -> list[AttitudeMeasurement]:
    """Return attitudes with errors of the modelled sizes, but of other processes: smoother and batch must still agree.
    """
    rng, found = np.random.default_rng(5), []
    mounted = {id_: MOUNTED * rng.standard_normal(3) for id_ in SENSORS}
    for ms, id_ in star_epochs():
        slow = np.array([TILT, HEADING, TILT]) * np.array([0.9, -1.1, 0.6]) * np.cos(ms / 9000.0)
        sensor = rotation_from_angles(*SENSORS[id_]) @ rotation_of(mounted[id_])
        rotation = (
            rotation_of(slow) @ ins_nd(ms / 1000.0 - 0.0011) @ sensor @ rotation_of(NOISE * rng.standard_normal(3))
        )
        common = COMMON**2 * np.eye(3) if id_ == "fore" else np.zeros((3, 3))
        stamp_ns = START_NS + ms * 1_000_000
        found.append(AttitudeMeasurement(f"star.{id_}", stamp_ns, rotation, np.diag(NOISE**2), common))
    return found


def smoothed_run() -> tuple[SmoothingCore, list[AttitudeEstimate]]:
    """Return a core that got all inputs in order of stamps, and the smoothed attitudes of each half second."""
    core, stars = SmoothingCore(CONFIG, None, None), measurements()
    for number in range(round(DURATION_S / INS_PERIOD_S)):
        ms = 20 * number
        time_ns = START_NS + ms * 1_000_000
        while stars and stars[0].time_ns <= time_ns:
            core.add_measurement(stars.pop(0))
        sample = AttitudeSample(time_ns, ins_nd(ms / 1000.0), rate_d(ms / 1000.0))
        outcome = core.ins.add(sample, estimate=ms % 500 == 240)
        assert all(decision.accepted for decision in outcome.decisions)
        core.take_smoothed()
    return core, list(core.smooth_remaining())


@dataclass
class BatchProblem:
    """Places of all unknowns by name and time, ms; each unknown has three numbers, the clock has one."""

    places: dict[tuple[str, int], slice] = field(default_factory=dict)
    size: int = 0

    def unknown(self, name: str, ms: int = 0, count: int = 3) -> slice:
        if (name, ms) not in self.places:
            self.places[name, ms] = slice(self.size, self.size + count)
            self.size += count
        return self.places[name, ms]

    def process(self, name: str, epochs: list[int], sigma: np.ndarray, time_s: np.ndarray) -> list[tuple]:
        """Return residuals of a Gauss-Markov process: of the first value, then of each value given the one before."""
        rows = [([self.unknown(name, epochs[0])], lambda first: first / sigma)]
        for before, after in pairwise(epochs):
            left = np.exp(-(after - before) / 1000.0 / time_s)
            fresh = sigma * np.sqrt(1.0 - left**2)
            step = lambda one, two, left=left, fresh=fresh: (two - left * one) / fresh  # noqa: E731
            rows.append(([self.unknown(name, before), self.unknown(name, after)], step))
        return rows


def batch_equations(batch: BatchProblem, requested_ms: list[int]) -> list[tuple]:
    stars = measurements()
    epochs = sorted({ms for ms, _ in star_epochs()} | set(requested_ms))
    fore = [ms for ms, id_ in star_epochs() if id_ == "fore"]
    three = np.ones(3)
    slow_sigma, slow_time = np.array([TILT, HEADING, TILT]), np.array([TILT_TIME_S, HEADING_TIME_S, TILT_TIME_S])
    rows = batch.process("slow", epochs, slow_sigma, slow_time)
    rows += batch.process("common", fore, COMMON * three, COMMON_TIME_S * three)
    rows += batch.process("flexure", fore, FLEXURE * three, FLEXURE_TIME_S * three)
    rows += [([batch.unknown(id_)], lambda mounted: mounted / MOUNTED) for id_ in SENSORS]
    rows.append(([batch.unknown("clock", count=1)], lambda clock_s: clock_s / CLOCK_S))
    for ms in sorted({ms for ms, _ in star_epochs()}):
        rows.append(([batch.unknown("white", ms)], lambda white: white / WHITE))
    for (ms, id_), star in zip(star_epochs(), stars, strict=True):
        names = ["slow", "white", *(["common", "flexure"] if id_ == "fore" else [])]
        used = [batch.unknown("clock", count=1), batch.unknown(id_), *(batch.unknown(name, ms) for name in names)]

        def residual(clock_s, mounted, slow, white, common=None, flexure=None, ms=ms, id_=id_, star=star):
            zero = np.zeros(3)
            common, flexure = (zero if one is None else one for one in (common, flexure))
            hull = (
                rotation_of(common)
                @ rotation_of(slow)
                @ rotation_of(white)
                @ ins_nd(ms / 1000.0 - clock_s[0])
                @ rotation_of(flexure)
            )
            predicted = hull @ rotation_from_angles(*SENSORS[id_]) @ rotation_of(mounted)
            return Rotation.from_matrix(predicted.T @ star.rotation_nv).as_rotvec() / NOISE

        rows.append((used, residual))
    return rows


def steps_of(batch: BatchProblem) -> np.ndarray:
    """Return the steps of the finite differences: 10 µs for the clock, 1e-6 for angles."""
    steps = np.full(batch.size, 1e-6)
    steps[batch.places["clock", 0]] = 1e-5
    return steps


@pytest.fixture(scope="module")
def both() -> tuple:
    core, smoothed = smoothed_run()
    smoothed_ms = [round((one.time_ns - START_NS) / 1e6) for one in smoothed]
    batch = BatchProblem()
    return core, smoothed, smoothed_ms, batch, *solve(batch_equations(batch, smoothed_ms), steps_of(batch))


@pytest.mark.slow
def test_smoothing_is_batch_least_squares(both: tuple) -> None:
    # Requirement: within 1 % of sigma.
    _, smoothed, smoothed_ms, batch, unknowns, factors = both
    assert len(smoothed) == 48
    worst_mean = worst_sigma = 0.0
    for one, ms in zip(smoothed, smoothed_ms, strict=True):
        parts = [batch.places["slow", ms], batch.places["clock", 0]]
        slow, clock_s = (unknowns[part] for part in parts)
        rotation_nd = rotation_of(slow) @ ins_nd(ms / 1000.0 - clock_s[0])
        by_clock = -(rotation_nd @ rate_d(ms / 1000.0 - clock_s[0]))
        jacobian = np.hstack([np.eye(3), by_clock[:, None]])
        expected = jacobian @ covariance_of(factors, batch.size, parts) @ jacobian.T + WHITE**2 * np.eye(3)
        sigma = np.sqrt(expected.diagonal())
        difference = Rotation.from_matrix(one.rotation_nd @ rotation_nd.T).as_rotvec()
        worst_mean = max(worst_mean, np.max(np.abs(difference) / sigma))
        worst_sigma = max(worst_sigma, np.max(np.abs(np.sqrt(one.covariance_n.diagonal()) / sigma - 1.0)))
    print(f"attitudes apart by {worst_mean:.5f} sigma, sigmas by {worst_sigma:.5f}")
    assert worst_mean < 0.01
    assert worst_sigma < 0.01


def test_the_filter_covariance_is_the_inverse_of_the_information_matrix(both: tuple) -> None:
    # After the last measurement the filter has used all data of the batch.
    core, _, _, batch, unknowns, factors = both
    last_ms = star_epochs()[-1][0]
    model, state = core.filter.model, core.state
    assert state.time_ns == START_NS + last_ms * 1_000_000
    parts = [batch.places[key] for key in (("slow", last_ms), ("clock", 0), ("fore", 0), ("starboard", 0))]
    names = ("ins.attitude", "ins.time_offset", "star.fore.installation", "star.starboard.installation")
    rows = np.concatenate([model.state_indices(name) for name in names])
    expected = covariance_of(factors, batch.size, parts)
    sigma = np.sqrt(expected.diagonal())
    both_sigmas = np.outer(sigma, sigma)
    mean, found = np.concatenate([unknowns[part] for part in parts]), state.covariance[np.ix_(rows, rows)]
    assert np.max(np.abs(state.mean[rows] - mean) / sigma) < 0.01
    np.testing.assert_allclose(found / both_sigmas, expected / both_sigmas, rtol=0, atol=0.01)
