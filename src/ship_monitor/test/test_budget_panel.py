"""Stacked variances: choice of the bands, cut-off peaks, labels of the axis."""

import numpy as np
import pytest

from ship_monitor.plots.budget_panel import (
    BudgetPanel,
    band_labels,
    largest_sources,
    peaks,
    root_ticks,
    top_of_axis,
    variances_arcsec2,
)
from ship_monitor.plots.curves import TimeAxis
from ship_monitor.themes import THEMES
from ship_testing.monitored_histories import ARCSEC, simulated_history


def test_five_largest_sources_have_bands_and_keep_them_for_small_changes() -> None:
    means = {"a": 5.0, "b": 4.0, "c": 3.0, "d": 2.0, "e": 1.0, "f": 0.9, "none": 0.0}
    bands = largest_sources(means, ())
    assert bands == ("a", "b", "c", "d", "e")
    assert largest_sources({**means, "f": 1.2}, bands) == bands
    assert largest_sources({**means, "f": 1.3}, bands) == ("a", "b", "c", "d", "f")


def test_short_peaks_are_cut_off_and_labelled() -> None:
    totals = np.full(600, 4.0)  # σ = 2″
    totals[200:230] = 30.0
    totals[210] = 30.25  # 5.5″
    totals[590:] = np.nan
    assert top_of_axis(totals) == 2.5
    assert peaks(np.arange(600) * 1e3, totals, 2.5) == [(210e3, 30.25)]
    assert peaks(np.arange(600) * 1e3, totals, 6.0) == []


def test_higher_of_two_overlapping_peak_labels_is_kept() -> None:
    totals = np.ones(600)
    totals[[100, 130, 400]] = 9.0, 16.0, 25.0
    assert peaks(np.arange(600) * 1e3, totals, 1.5) == [(130e3, 16.0), (400e3, 25.0)]


@pytest.mark.parametrize("top", [1.0, 1.5, 2.5, 4.0, 10.0, 40.0, 200.0])
def test_axis_labels_are_round_and_do_not_overlap(top: float) -> None:
    ticks = root_ticks(top)
    assert ticks[0] == 0.0
    assert len(ticks) >= 3
    assert all(np.diff(np.square(ticks)) >= 0.1 * top**2)
    assert ticks[-1] <= top


def test_bands_are_labelled_at_their_middle() -> None:
    last = {"drift": 4.0, "noise": 2.25, "fix": 0.01}
    texts = band_labels(last, ("drift", "noise"), 9.0)
    assert list(texts.values()) == ["drift 2.00″", "noise 1.50″", "other 0.10″"]
    heights = list(texts)
    assert heights[0] == pytest.approx(2.0)
    assert heights[1] == pytest.approx(4.0 + 2.25 / 2)
    assert heights[2] - heights[1] >= 0.115 * 9.0 - 1e-9


@pytest.mark.slow
def test_bands_add_up_to_the_total_of_the_chosen_angle() -> None:
    history = simulated_history()
    panel = BudgetPanel(THEMES["day"], TimeAxis(600.0))
    panel.update(history, "")
    assert panel.angle == "heading"
    heading = np.asarray(panel._trail.source.data["total"])
    panel.choose("roll")
    panel.update(history, "")
    roll = np.asarray(panel._trail.source.data["total"])
    points = history.budgets["ship/error_budget"]
    totals = np.array([sum(point.by_angle["roll"].values()) for point in points]) / ARCSEC**2
    assert roll == pytest.approx(totals[:-1])
    assert roll == pytest.approx(2.0 * heading)
    parts = variances_arcsec2(points, "roll", ("ins_noise", "not published"))
    assert parts[:, 0] == pytest.approx(2.0 * 1.19**2)
    assert np.isnan(parts[:, 1]).all()
