"""Error of interpolation for a rolling ship: the tables of docs/explanation/interpolation.md, measured."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, log_rotation
from ship_geometry.tracks.attitude_track import AttitudeSample, AttitudeTrack

Motion = Callable[[float], np.ndarray]

DOCUMENT = Path(__file__).parents[3] / "docs" / "explanation" / "interpolation.md"
SECOND_NS = 1_000_000_000
PERIOD_S = 8
RATES_HZ = [1, 10, 50, 100]
FRACTIONS = range(1, 10)  # tenths of an interval; the maxima lie at 0.2, 0.5 and 0.8 within 1 %
BIAS_ARCSEC_PER_S = 1.0


def roll_only(time_s: float) -> np.ndarray:
    return rotation_from_angles(0.0, 0.0, np.deg2rad(10.0) * np.sin(2 * np.pi * time_s / PERIOD_S))


def roll_pitch_and_turn(time_s: float) -> np.ndarray:
    heading, pitch = np.deg2rad(3.0 * time_s), np.deg2rad(5.0) * np.sin(2 * np.pi * time_s / 6.0)
    return rotation_from_angles(heading, pitch, np.deg2rad(10.0) * np.sin(2 * np.pi * time_s / PERIOD_S + 0.3))


MOTIONS: list[Motion] = [roll_only, roll_pitch_and_turn]


def rate_of(motion: Motion, time_s: float) -> np.ndarray:
    turn = motion(time_s - 1e-4).T @ motion(time_s + 1e-4)
    return Rotation.from_matrix(turn).as_rotvec() / 2e-4


def greatest_error_arcsec(found: np.ndarray, motion: Motion, times_s: np.ndarray) -> float:
    true = np.stack([motion(t) for t in times_s])
    return float(np.linalg.norm(log_rotation(np.swapaxes(found, -1, -2) @ true), axis=-1).max()) / ARCSEC


def error_of_track_arcsec(motion: Motion, rate_hz: int, measured_rates: bool, rate_error: float = 0.0) -> float:
    step_ns = SECOND_NS // rate_hz
    track = AttitudeTrack(2 * step_ns)
    # Samples before and after the period keep the ends of the track out of the test.
    for k in range(-3, PERIOD_S * rate_hz + 4):
        time_s = k / rate_hz
        rate_d = rate_of(motion, time_s) + rate_error * np.eye(3)[0] if measured_rates else None
        track.insert(AttitudeSample(k * step_ns, motion(time_s), rate_d))
    # At the higher rates some intervals are skipped: neighbouring ones hardly differ.
    starts = range(0, PERIOD_S * rate_hz, max(rate_hz // 10, 1))
    times_ns = [k * step_ns + tenth * step_ns // 10 for k in starts for tenth in FRACTIONS]
    attitudes = [track.at(t) for t in times_ns]
    rotations = np.stack([a.rotation_nd for a in attitudes if a is not None])
    return greatest_error_arcsec(rotations, motion, np.array(times_ns) / SECOND_NS)


def error_of_slerp_arcsec(motion: Motion, rate_hz: int) -> float:
    samples_s = np.arange(PERIOD_S * rate_hz + 1) / rate_hz
    slerp = Slerp(samples_s, Rotation.from_matrix([motion(t) for t in samples_s]))
    times_s = (np.arange(PERIOD_S * rate_hz) + 0.5) / rate_hz
    return greatest_error_arcsec(slerp(times_s).as_matrix(), motion, times_s)


def documented_tables() -> list[dict[int, list[float]]]:
    """Return for each table: samples per second → the numbers of the row."""
    tables: list[dict[int, list[float]]] = []
    for line in DOCUMENT.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] == "samples per second":
            tables.append({})
        elif line.startswith("|") and cells[0].isdigit():
            tables[-1][int(cells[0])] = [float(cell) for cell in cells[1:]]
    return tables


def test_document_has_a_table_for_each_motion_and_rate() -> None:
    assert [sorted(table) for table in documented_tables()] == [RATES_HZ, RATES_HZ]


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("which", [0, 1], ids=["roll", "roll-pitch-turn"])
def test_documented_errors_are_what_is_measured(which: int, rate_hz: int) -> None:
    motion = MOTIONS[which]
    measured = [
        error_of_track_arcsec(motion, rate_hz, measured_rates=True),
        error_of_track_arcsec(motion, rate_hz, measured_rates=False),
        error_of_slerp_arcsec(motion, rate_hz),
    ]
    np.testing.assert_allclose(measured, documented_tables()[which][rate_hz], rtol=0.02)


@pytest.mark.parametrize("rate_hz", [10, 50, 100])
def test_errors_of_one_axis_are_those_of_theory(rate_hz: int) -> None:
    """Remainders of a cubic with true slopes, with central differences, and of a straight line."""
    h, w, amplitude_arcsec = 1.0 / rate_hz, 2 * np.pi / PERIOD_S, 36000.0
    with_rates = amplitude_arcsec * w**4 * h**4 / 384
    differenced = amplitude_arcsec * w**3 * h**3 / (36 * 3**0.5)
    straight = amplitude_arcsec * w**2 * h**2 / 8
    assert error_of_track_arcsec(roll_only, rate_hz, measured_rates=True) == pytest.approx(with_rates, rel=0.02)
    assert error_of_track_arcsec(roll_only, rate_hz, measured_rates=False) == pytest.approx(differenced, rel=0.02)
    assert error_of_slerp_arcsec(roll_only, rate_hz) == pytest.approx(straight, rel=0.02)


def test_constant_error_of_the_rate_enters_by_a_tenth_of_a_step() -> None:
    error_arcsec = error_of_track_arcsec(roll_only, 10, measured_rates=True, rate_error=BIAS_ARCSEC_PER_S * ARCSEC)
    alone_arcsec = error_of_track_arcsec(roll_only, 10, measured_rates=True)
    # The greatest value of s (1-s) (1-2s) is 0.0962.
    assert 0.0090 < error_arcsec < 0.0097 + alone_arcsec


# -- the error estimated by the track


def claims(rate_hz: float, measured_rates: bool, noise_arcsec: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return errors between samples (rotation vectors in d), (n, 3), and their estimated covariances, (n, 3, 3)."""
    rng = np.random.default_rng(27)
    step_ns = round(SECOND_NS / rate_hz)
    track = AttitudeTrack(2 * step_ns)
    for k in range(-6, 40):
        time_s = k * step_ns / SECOND_NS
        noise = Rotation.from_rotvec(noise_arcsec * ARCSEC * rng.standard_normal(3)).as_matrix()
        rate_d = rate_of(roll_pitch_and_turn, time_s) if measured_rates else None
        track.insert(AttitudeSample(k * step_ns, roll_pitch_and_turn(time_s) @ noise, rate_d))
    errors, covariances = [], []
    for time_ns in rng.integers(0, 37 * step_ns, 150).tolist():
        found = track.at(time_ns)
        assert found is not None
        errors.append(log_rotation(found.rotation_nd.T @ roll_pitch_and_turn(time_ns / SECOND_NS)))
        covariances.append(found.error_covariance_d)
    return np.array(errors), np.array(covariances)


@pytest.mark.parametrize(
    ("rate_hz", "measured_rates"),
    [(1.0, True), *((hz, rates) for hz in (1.5, 2.5, 5.0, 10.0) for rates in (True, False))],
)
def test_estimated_interpolation_error_equals_the_actual_one(rate_hz: float, measured_rates: bool) -> None:
    errors, covariances = claims(rate_hz, measured_rates)
    made, claimed = np.mean(errors**2), np.mean(np.trace(covariances, axis1=-2, axis2=-1)) / 3.0
    assert made < claimed < 1.8 * made + (0.04 * ARCSEC) ** 2
    covariances += (1e-6 * ARCSEC) ** 2 * np.eye(3)  # the resolution of doubles
    distance = np.einsum("ki,ki->k", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
    # The normalised square of three axes is below 3 on average; noise of this size exceeds 20 once in 6000 times.
    assert np.mean(distance) < 3.0
    assert np.max(distance) < 20.0


@pytest.mark.parametrize(("measured_rates", "share"), [(True, 0.02), (False, 0.08)])
def test_sample_noise_is_not_estimated_as_interpolation_error(measured_rates: bool, share: float) -> None:
    _, covariances = claims(100.0, measured_rates, noise_arcsec=1.0)
    claimed = np.mean(np.trace(covariances, axis1=-2, axis2=-1)) / 3.0
    # For comparison: the variance due to the samples themselves is 0.5 or 0.64 in the middle of an interval.
    assert claimed < share * ARCSEC**2


@pytest.mark.parametrize("measured_rates", [True, False])
@pytest.mark.parametrize(("rate_hz", "ahead_s"), [(2.5, 0.005), (5.0, -0.003), (5.0, 0.1), (100.0, 0.1)])
def test_newest_sample_has_the_error_of_its_propagation(
    rate_hz: float, ahead_s: float, measured_rates: bool
) -> None:
    distances, made, claimed = [], [], []
    step_ns = round(SECOND_NS / rate_hz)
    for start in range(24):
        track = AttitudeTrack(2 * step_ns)
        count = max(10, round(rate_hz))
        for k in range(count):
            time_s = start + k / rate_hz
            rate_d = rate_of(roll_pitch_and_turn, time_s) if measured_rates else None
            track.insert(AttitudeSample(k * step_ns, roll_pitch_and_turn(time_s), rate_d))
        moved = track.propagate_newest(ahead_s)
        error = log_rotation(moved.rotation_nd.T @ roll_pitch_and_turn(start + (count - 1) / rate_hz + ahead_s))
        distances.append(error @ np.linalg.solve(moved.error_covariance_d, error))
        made.append(error @ error)
        claimed.append(np.trace(moved.error_covariance_d))
    assert np.mean(distances) < 3.0
    assert np.max(distances) < 20.0
    # Without rates the estimate contains the effect of interpolation on an estimated clock offset, too.
    assert np.mean(claimed) < (4.0 if measured_rates else 60.0) * np.mean(made) + (0.02 * ARCSEC) ** 2


def test_error_is_bounded_by_half_a_turn() -> None:
    track = AttitudeTrack(SECOND_NS)
    for k in range(5):
        track.insert(AttitudeSample(k * SECOND_NS, np.eye(3), np.full(3, 1e9 * (-1) ** k)))
    found = track.at(2 * SECOND_NS + SECOND_NS // 3)
    assert found is not None
    assert np.trace(found.error_covariance_d) < 2.0 * np.pi**2
    assert np.trace(track.propagate_newest(0.1).error_covariance_d) < 2.0 * np.pi**2
