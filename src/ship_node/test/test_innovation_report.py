"""Innovation diagnoses as diagnostics: one status per source with its figures, bounded, cleared by a reset."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from ship_estimation.kalman.kalman_filter import StateModel, block
from ship_estimation.rejection_rules import Reason
from ship_estimation.time_order.outcome import MeasurementDecision
from ship_geometry.rotations import ARCSEC
from ship_node.adapters.adapter_report import InnovationReport, clock_status
from ship_node.messages.common_messages import Level

STATED = (3.0 * ARCSEC) ** 2 * np.eye(2)


def decisions(factor: float, count: int = 100) -> list[tuple[str, MeasurementDecision]]:
    rng = np.random.default_rng(1)
    residuals = factor * 3.0 * ARCSEC * rng.standard_normal((count, 2))
    return [
        (
            "star.bow",
            MeasurementDecision(
                SimpleNamespace(time_ns=200_000_000 * k),
                Reason.NONE,
                True,
                ("up", "right"),
                residual,
                covariance=STATED,
                noise=STATED,
                nis=float(np.sum(residual**2) / STATED[0, 0]),
            ),
        )
        for k, residual in enumerate(residuals)
    ]


def test_a_source_as_stated_is_ok_and_shows_its_figures() -> None:
    report = InnovationReport()
    report.pending += decisions(1.0)
    (status,) = report.statuses()
    assert (status.name, status.level) == ("verdict star.bow", Level.OK)
    assert status.message.startswith("as stated")
    assert status.values["measurements"] == "100"
    low, high = chi2.ppf([0.5e-7, 1.0 - 0.5e-7], 200) / 200  # of the mean of 200 squares
    assert status.values["NIS per component"].endswith(f"(expected {low:.2f} to {high:.2f})")
    assert set(status.values) >= {"factor of its sigma", "outliers (%)", "bias up (sigma)", "correlation right"}
    assert report.statuses() == [status]  # evaluated once, reported as long as it applies
    assert not report.pending


def test_an_understated_sigma_is_a_warning() -> None:
    report = InnovationReport()
    report.pending += decisions(3.0)
    (status,) = report.statuses()
    assert status.level is Level.WARN
    assert status.message.startswith("sigma optimistic by ")
    assert float(status.values["factor of its sigma"]) == pytest.approx(3.0, rel=0.2)


def test_too_few_measurements_are_no_warning_and_have_no_figures() -> None:
    report = InnovationReport()
    report.pending += decisions(3.0, count=5)
    (status,) = report.statuses()
    assert (status.level, status.values) == (Level.OK, {"measurements": "5"})


def test_pending_decisions_are_bounded_and_cleared_by_a_reset() -> None:
    report = InnovationReport()
    report.pending += decisions(1.0, count=50) * 200
    assert len(report.pending) == 5000
    report.statuses()
    report.pending += decisions(1.0)
    report.clear()
    assert (len(report.pending), report.statuses()) == (0, [])


def test_a_clock_beyond_its_sigma_is_a_warning() -> None:
    model = StateModel([block("ins.time_offset", [0.0015], "ins")], noise_sources=[])
    assert clock_status(model, np.array([0.001]), {}).level is Level.OK
    status = clock_status(model, np.array([0.012]), {})
    assert (status.name, status.level) == ("clocks", Level.WARN)
    assert status.message == "ins clock off by 12 ms, 8 sigma of ins.time_offset_sigma_s"
