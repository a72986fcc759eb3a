"""Error of interpolation for a rolling ship: the tables of docs/interpolation.md, measured."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from ship_geometry.attitude_track import AttitudeSample, AttitudeTrack
from ship_geometry.frames import rotation_from_angles
from ship_geometry.rotations import ARCSEC, log_rotation

Motion = Callable[[float], np.ndarray]

DOCUMENT = Path(__file__).parents[3] / "docs" / "interpolation.md"
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
    # Some samples beyond the period on both sides: the track's ends are no part of the question.
    for k in range(-3, PERIOD_S * rate_hz + 4):
        time_s = k / rate_hz
        rate_d = rate_of(motion, time_s) + rate_error * np.eye(3)[0] if measured_rates else None
        track.insert(AttitudeSample(k * step_ns, motion(time_s), rate_d))
    # One interval in some at the higher rates: neighbouring ones hardly differ.
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
    """Of each table: samples per second → the row's numbers."""
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
