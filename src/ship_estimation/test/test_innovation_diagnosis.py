"""Innovation diagnosis: each kind is distinguished, with its values, and none for a source that is as stated."""

from dataclasses import replace

import numpy as np
import pytest

from ship_estimation.innovations.innovation_diagnosis import (
    WINDOW_S,
    DiagnosisKind,
    InnovationDiagnosis,
    InnovationHistory,
    clock_diagnoses,
)
from ship_estimation.innovations.innovation_statistics import LEAST_COUNT
from ship_estimation.kalman.kalman_filter import StateModel, block
from ship_estimation.rejection_rules import Reason, Rejection
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_geometry.earth.time_scales import SECOND_NS
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_geometry.tracks.sample_track import VectorSample

ATTITUDE = ("forward", "up", "right")
SIGMA = np.array([100.0, 3.0, 3.0]) * ARCSEC
PERIOD_NS = SECOND_NS // 5
GATE = 21.11
STARS = tuple(f"HIP {star} {axis}" for star in range(8) for axis in ("up", "right"))
STAR_SIGMA = 5.0 * ARCSEC
PREDICTED_SIGMA = 1.0 * ARCSEC
"""Error of the prediction in each component of an attitude."""
MINUTE = 300
"""Number of measurements in a minute."""


def attitude(k: int, noise: FloatArray) -> MeasurementDecision[VectorSample]:
    """Return decision ``k`` about an attitude; the residual is ``noise`` times the sigmas, plus a prediction error."""
    stated = np.diag(SIGMA**2)
    covariance = stated + PREDICTED_SIGMA**2 * np.eye(3)
    predicted = PREDICTED_SIGMA * np.random.default_rng([77, k]).standard_normal(3)
    residual = noise * SIGMA + predicted
    nis = float(residual @ np.linalg.solve(covariance, residual))
    return MeasurementDecision(
        VectorSample(k * PERIOD_NS, residual),
        Reason.NONE if nis <= GATE else Reason.GATE,
        nis <= GATE,
        ATTITUDE,
        residual,
        covariance=covariance,
        noise=stated,
        nis=nis,
    )


def exposure(k: int, noise: FloatArray) -> MeasurementDecision[VectorSample]:
    """Return decision ``k`` about stars with ``noise`` in sigmas, shape (8, 2); outliers are rejected."""
    squares = np.sum(noise**2, axis=-1)
    kept = squares < 16.0
    # The worst are rejected until the others are consistent.
    while kept.any() and np.sum(squares[kept]) > 2.5 * 2 * np.sum(kept):
        kept[np.argmax(np.where(kept, squares, -1.0))] = False
    names = tuple(name for row, name in enumerate(STARS) if kept[row // 2])
    stated = STAR_SIGMA**2 * np.eye(len(names))
    covariance = stated + PREDICTED_SIGMA**2 * np.ones_like(stated)
    predicted = PREDICTED_SIGMA * np.random.default_rng([78, k]).standard_normal()
    residual = noise[kept].ravel() * STAR_SIGMA + predicted
    left_out = tuple((STARS[2 * row], Rejection(Reason.MISIDENTIFIED, "far")) for row in np.flatnonzero(~kept))
    if not names:
        return MeasurementDecision(VectorSample(k * PERIOD_NS, noise), Reason.MISIDENTIFIED, rejected_parts=left_out)
    nis = float(residual @ np.linalg.solve(covariance, residual))
    return MeasurementDecision(
        VectorSample(k * PERIOD_NS, residual),
        Reason.NONE,
        True,
        names,
        residual,
        covariance=covariance,
        noise=stated,
        nis=nis,
        rejected_parts=left_out,
    )


def diagnosis(decisions: list[MeasurementDecision[VectorSample]]) -> InnovationDiagnosis:
    history = InnovationHistory()
    for decision in decisions:
        history.add("star.bow", decision)
    return history.diagnoses()["star.bow"]


def of_attitudes(noise: FloatArray) -> InnovationDiagnosis:
    return diagnosis([attitude(k, row) for k, row in enumerate(noise)])


def white(seed: int, count: int = MINUTE, shape: tuple[int, ...] = (3,)) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((count, *shape))


@pytest.mark.statistics
@pytest.mark.parametrize("count", [LEAST_COUNT, 60, MINUTE])
def test_consistent_attitudes_are_as_stated(count: int) -> None:
    """120 windows: the stated probability of another result is one in a million."""
    found = [of_attitudes(white(seed, count)) for seed in range(40)]
    assert {one.kind for one in found} == {DiagnosisKind.AS_STATED}
    # The median of n values of chi² with 3 degrees has a relative sigma of 1.05 / √n. The limit is 3.5 of these sigmas,
    # halved because the factor is the root of chi².
    assert all(abs(one.factor - 1.0) < 0.5 * 3.5 * 1.05 / np.sqrt(count) + 0.02 for one in found)
    inside = [one.nis_band[0] < one.nis < one.nis_band[1] for one in found if one.nis_band]
    assert len(inside) == 40
    assert all(inside)


def test_consistent_stars_are_as_stated() -> None:
    found = [diagnosis([exposure(k, noise) for k, noise in enumerate(white(seed, 60, (8, 2)))]) for seed in range(40)]
    assert {one.kind for one in found} == {DiagnosisKind.AS_STATED}


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.5, 2.0, 3.0, 10.0])
def test_understated_attitude_noise_is_reported_with_its_factor_in_spite_of_rejections(
    factor: float,
) -> None:
    for seed in range(10):
        found = of_attitudes(factor * white(seed))
        assert found.kind is DiagnosisKind.OPTIMISTIC
        assert found.factor == pytest.approx(factor, rel=0.2)
    assert f"optimistic by {found.factor:.1f}" in found.text


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.5, 2.0, 3.0])
def test_understated_star_noise_is_distinguished_from_misidentification(factor: float) -> None:
    """Many stars have slightly large innovations, and the selection rejects the worst stars."""
    for seed in range(5):
        found = diagnosis([exposure(k, factor * noise) for k, noise in enumerate(white(seed, shape=(8, 2)))])
        assert found.kind is DiagnosisKind.OPTIMISTIC
        assert found.factor == pytest.approx(factor, rel=0.2)


def test_one_outlier_star_in_each_exposure_is_misidentified() -> None:
    noise = white(3, shape=(8, 2))
    noise[:, 5] += 30.0
    found = diagnosis([exposure(k, one) for k, one in enumerate(noise)])
    assert found.kind is DiagnosisKind.MISIDENTIFIED
    assert found.outlier_share == pytest.approx(1 / 8, abs=0.01)
    assert found.factor == pytest.approx(1.0, abs=0.1)
    assert found.text.startswith("misidentified: 13 % are outliers, the others are as stated")


def test_some_outlier_attitudes_are_misidentified() -> None:
    noise = white(4)
    rng = np.random.default_rng(5)
    wrong = rng.random(MINUTE) < 0.2
    noise[wrong] = 50.0 * rng.standard_normal((int(wrong.sum()), 3))
    assert of_attitudes(noise).kind is DiagnosisKind.MISIDENTIFIED


def test_exposures_without_a_usable_star_are_misidentified() -> None:
    found = diagnosis([exposure(k, one) for k, one in enumerate(1000.0 * white(6, shape=(8, 2)))])
    assert found.kind is DiagnosisKind.MISIDENTIFIED
    assert "100 % are outliers; " in found.text


@pytest.mark.parametrize("factor", [1.5, 2.0, 4.0])
def test_an_overstated_noise_is_conservative(factor: float) -> None:
    found = of_attitudes(white(7) / factor)
    assert found.kind is DiagnosisKind.CONSERVATIVE
    # The prediction error, 1″ of the stated 3″, is as stated and limits the detection of a smaller noise.
    assert found.factor == pytest.approx(1.0 / factor, abs=0.1)


def test_shifted_sensor_with_all_measurements_rejected_is_biased() -> None:
    noise = white(8)
    noise[:, 1] += 50.0 / 3.0  # 50″ about up, stated 3″
    decisions = [attitude(k, row) for k, row in enumerate(noise)]
    assert not any(decision.accepted for decision in decisions)
    found = diagnosis(decisions)
    assert found.kind is DiagnosisKind.BIASED
    assert found.text.startswith("bias of +50.")
    assert "arcsec in up" in found.text
    assert "steady: check installation and alignment" in found.text


def test_common_prediction_error_of_an_excluded_source_is_no_bias() -> None:
    """The filter without the source may have an error of two sigmas, 2″, while the source is excluded."""
    noise = white(16)
    noise[:, 1] += 2.0 / 3.0
    decisions = [attitude(k, row) for k, row in enumerate(noise)]
    assert diagnosis(decisions).kind is DiagnosisKind.BIASED
    excluded = [replace(decision, accepted=False, reason=Reason.EXCLUDED) for decision in decisions]
    assert diagnosis(excluded).kind is DiagnosisKind.AS_STATED
    noise[:, 1] += 10.0
    shifted = [replace(attitude(k, row), accepted=False, reason=Reason.EXCLUDED) for k, row in enumerate(noise)]
    assert diagnosis(shifted).kind is DiagnosisKind.BIASED


def test_a_bias_that_grows_is_not_steady() -> None:
    noise = white(9)
    noise[:, 2] += np.linspace(0.0, 8.0, MINUTE)
    found = of_attitudes(noise)
    assert found.kind is DiagnosisKind.BIASED
    assert "a drift" in found.text


def test_correlated_errors_are_reported() -> None:
    noise, rho = white(10), 0.6
    for k in range(1, MINUTE):
        noise[k] = rho * noise[k - 1] + np.sqrt(1.0 - rho**2) * noise[k]
    found = of_attitudes(noise)
    assert found.kind is DiagnosisKind.CORRELATED
    assert found.correlation["forward"] == pytest.approx(rho, abs=0.15)


def test_alternating_innovations_are_reported() -> None:
    noise = white(11, MINUTE + 1)
    found = of_attitudes((noise[1:] - noise[:-1]) / np.sqrt(2.0))  # correlation -0.5
    assert found.kind is DiagnosisKind.CORRELATED
    assert "too closely" in found.text


def test_too_few_measurements_in_the_window_give_no_diagnosis() -> None:
    wrong = [attitude(k, 5.0 * row) for k, row in enumerate(white(12, LEAST_COUNT - 1))]
    found = diagnosis(wrong)
    assert (found.kind, found.count) == (DiagnosisKind.UNKNOWN, LEAST_COUNT - 1)
    later = round(WINDOW_S * SECOND_NS) // PERIOD_NS + LEAST_COUNT
    good = [attitude(later + k, row) for k, row in enumerate(white(13))]
    assert diagnosis([*wrong, *wrong, *good]).kind is DiagnosisKind.AS_STATED


def test_sigma_is_not_assessed_by_an_uncertain_prediction() -> None:
    rng, decisions = np.random.default_rng(14), []
    for k in range(MINUTE):
        residual = 10.0 * ARCSEC * rng.standard_normal(3)
        covariance = (10.0 * ARCSEC) ** 2 * np.eye(3)
        decision = MeasurementDecision(
            VectorSample(k * PERIOD_NS, residual), Reason.NONE, True, ATTITUDE, residual, covariance=covariance,
            noise=0.01 * covariance, nis=float(np.sum(residual**2)) / (10.0 * ARCSEC) ** 2,
        )  # fmt: skip
        decisions.append(decision)
    found = diagnosis(decisions)
    assert found.kind is DiagnosisKind.UNKNOWN
    assert "less certain than the measurements" in found.text


def test_measurements_without_innovation_are_ignored() -> None:
    history = InnovationHistory()
    sample = VectorSample(1, np.zeros(3))
    history.add("star.bow", MeasurementDecision(sample, Reason.GAP))
    history.add(
        "star.bow", MeasurementDecision(sample, Reason.NONE, True, ATTITUDE, np.full(3, np.nan), covariance=np.eye(3))
    )
    history.add(
        "star.bow", MeasurementDecision(sample, Reason.NONE, True, ATTITUDE, np.zeros(3))
    )  # without a covariance
    assert history.diagnoses() == {}


def test_repeated_decision_replaces_the_earlier_one_in_any_order() -> None:
    noise = white(15)
    decisions = [attitude(k, row) for k, row in enumerate(noise)]
    wrong = [attitude(k, row + 100.0) for k, row in enumerate(noise)]
    expected = diagnosis(decisions)
    assert diagnosis([*wrong, *decisions]) == expected
    assert diagnosis(decisions[::-1]) == expected


def test_cleared_history_is_empty() -> None:
    history = InnovationHistory()
    history.add("star.bow", attitude(0, np.zeros(3)))
    history.clear()
    assert history.diagnoses() == {}


def test_constant_values_are_assessed_without_a_division_by_zero() -> None:
    shape = {"covariance": np.eye(3), "noise": np.eye(3)}
    sample = [
        MeasurementDecision(VectorSample(k, np.zeros(3)), Reason.NONE, True, ATTITUDE, np.zeros(3), nis=0.0, **shape)
        for k in range(40)
    ]
    assert diagnosis(sample).kind is DiagnosisKind.CONSERVATIVE


def test_clock_offset_is_reported_above_four_configured_sigmas() -> None:
    blocks = [
        block("ins.attitude", [1.0, 1.0, 1.0], "ins"),
        block("ins.time_offset", [0.0015], "ins_time"),
        block("star.bow.time_offset", [0.001], "star_time"),
        block("star.aft.time_offset", [0.0], "star_time"),
    ]
    model = StateModel(blocks, noise_sources=[])
    mean = np.array([9.0, 9.0, 9.0, 0.012, -0.0039, 1.0])
    assert clock_diagnoses(model, mean, {"star": "star_sensors"}) == [
        "ins clock off by 12 ms, 8 sigma of ins.time_offset_sigma_s"
    ]
    mean[4] = -0.0041
    reports = clock_diagnoses(model, mean, {"star": "star_sensors"})
    assert reports[1:] == ["star.bow clock off by -4.1 ms, 4 sigma of star_sensors.bow.time_offset_sigma_s"]
