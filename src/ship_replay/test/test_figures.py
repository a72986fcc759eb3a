"""Figures of a run: scales, names, and no overlapping labels."""

from html import escape
from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC
from ship_node.pages.figure_files import MAX_ROWS, save_figure, settled_slice
from ship_replay.evaluation.figures import attitude_error_figure, innovation_figure
from ship_replay.evaluation.statistics import AcceptedInnovation, AttitudeErrors, SourceInnovations
from ship_replay.report.drawings import budget_svg
from ship_watch.history.history import BudgetPoint

COUNT = 200
CHANNELS = ("heading", "pitch", "roll")


def errors(label, sigma_arcsec, error_arcsec=1.0, channels=CHANNELS):
    """Errors 1 s apart that alternate about zero."""
    sign = np.where(np.arange(COUNT) % 2, 1.0, -1.0)[:, None]
    return AttitudeErrors(
        label,
        channels,
        np.arange(COUNT) * 10**9,
        sign * np.broadcast_to(error_arcsec, (COUNT, 3)),
        np.broadcast_to(np.reshape(sigma_arcsec, (-1, 1)), (COUNT, 3)),
        np.full(COUNT, 3.0),
    )


def innovations(sigma_arcsec):
    accepted = {
        number * 10**9: AcceptedInnovation(("forward", "up"), np.full(2, ARCSEC), np.full(2, sigma * ARCSEC), 2.0)
        for number, sigma in enumerate(sigma_arcsec)
    }
    return SourceInnovations(accepted)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.8])
def test_the_first_sigma_sets_no_scale(share):
    sigma = np.where(np.arange(COUNT) < share * COUNT, 3600.0, 2.0)
    error = np.where(sigma > 100.0, 900.0, 1.0)[:, None]
    for figure in (
        attitude_error_figure([errors("fused", sigma, error), errors("ins", 5.0)], "t"),
        innovation_figure({"star.fore": innovations(sigma)}, "t"),
    ):
        assert all(axes.get_ylim()[1] < 10.0 for axes in figure.axes), [axes.get_ylim() for axes in figure.axes]
        plt.close(figure)
    # An outage later on is no start.
    assert settled_slice(sigma[::-1]) == slice(0, None)
    assert settled_slice(np.full(3, np.nan)) == slice(None)


def test_a_sensor_beyond_the_scale_or_without_a_measurement_is_named():
    figure = attitude_error_figure([errors("fused", 2.0), errors("star.mast", 2.0, 900.0), errors("ins", 2.0)], "t")
    lost = errors("star.mast", np.where(np.arange(COUNT) < COUNT - 30, 9000.0, 2.0), 1.0)
    lost.error_arcsec[: COUNT - 30] *= 900.0
    scaled = attitude_error_figure([errors("fused", 2.0), lost], "t")
    words = [text.get_text() for axes in scaled.axes for text in axes.texts]
    assert words == ["star.mast: beyond the scale, median 900 arcsec"] * 3
    assert not any(axes.texts for axes in figure.axes)
    title = innovation_figure({"star.fore": innovations([1.0] * 9), "star.mast": SourceInnovations()}, "t")
    assert title.get_suptitle() == "t\nnothing accepted of: star.mast"
    plt.close("all")


def test_labels_and_legends_do_not_overlap():
    several = [errors("fused", 2.0), *(errors(f"star.bridge_wing_{number}", 2.0) for number in range(5))]
    pointing = errors("pointing", 2.0, channels=("azimuth_cos_elevation", "elevation", "image_rotation"))
    sources = {f"star.a_sensor_with_a_long_name_{number}": innovations([1.0] * 9) for number in range(3)}
    for figure in (attitude_error_figure([*several, pointing], "t"), innovation_figure(sources, "t")):
        figure.canvas.draw()
        frames = [axes.get_window_extent() for axes in figure.axes]
        labels = [axes.yaxis.label.get_window_extent() for axes in figure.axes if axes.get_ylabel()]
        legends = [axes.get_legend().get_window_extent() for axes in figure.axes if axes.get_legend() is not None]
        assert legends
        assert not any(one.overlaps(other) for one, other in combinations([*labels, *legends], 2))
        assert not any(box.overlaps(frame) for box in [*labels, *legends] for frame in frames)
        plt.close(figure)


@pytest.mark.parametrize("name", ["a$x^{$", "$5 and $6", r"\frac{$1$}{2}", "<b>&amp;$$"])
def test_a_name_with_dollars_is_a_name_and_no_formula(name, tmp_path):
    many = [errors(name, 2.0), errors("star.$mast$", 2.0, 900.0)]
    for number, figure in enumerate(
        (attitude_error_figure(many, name), innovation_figure({name: innovations([2.0] * COUNT)}, name))
    ):
        path = tmp_path / f"{number}.svg"
        with plt.rc_context({"svg.fonttype": "none"}):
            save_figure(figure, path)
        assert escape(name, quote=False) in path.read_text()


def test_the_drawings_of_a_report_take_no_name_for_a_formula():
    name = r"$\alpha_{$ <script>$x$"
    points = [BudgetPoint(second * 10**9, {"heading": {name: ARCSEC**2}}) for second in range(20)]
    drawn = budget_svg("ship/error_budget", points, 0)
    assert "$" in drawn
    assert "<script" not in drawn


def test_a_figure_of_hundreds_of_sources_has_a_row_for_the_first_of_them():
    many = {f"star.{number}": innovations([2.0] * 20) for number in range(200)}
    figure = innovation_figure(many, "t")
    assert len(figure.axes) == MAX_ROWS
    assert f"the first {MAX_ROWS} of 400 components" in figure.get_suptitle()
    plt.close(figure)
