"""A real alt-azimuth mount: 118 sightings of stars on two nights, and an observatory package's own fit of them.

Expected values: the README of the sightings, and models.md §5.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ship_geometry.rotations import ARCSEC
from ship_studies.axis_fit.diagnostics import correlated_pairs, near_dependencies, table_warnings
from ship_studies.axis_fit.robust_fit import AxisFit, fit, rms, sizes
from ship_studies.axis_fit.sightings import Sightings, directions, read_sightings

TABLE = Path(__file__).parents[3].parent / "shared" / "data" / "altaz_mount" / "pointing.csv"

pytestmark = pytest.mark.skipif(not TABLE.is_file(), reason=f"the mount's sightings are not here: {TABLE}")


@pytest.fixture(scope="module")
def sightings() -> Sightings:
    return read_sightings(TABLE)


@pytest.fixture(scope="module")
def six_terms(sightings: Sightings) -> AxisFit:
    return fit(sightings, {"flexure": 0.0})


def test_six_terms(six_terms: AxisFit) -> None:
    assert rms(six_terms.before) / ARCSEC == pytest.approx(39.56, abs=0.01)
    assert rms(six_terms.residuals) / ARCSEC <= 12.05
    assert np.median(sizes(six_terms.residuals)) / ARCSEC <= 7.7
    assert rms(six_terms.leave_one_out) / ARCSEC <= 12.5


def test_outliers(sightings: Sightings, six_terms: AxisFit) -> None:
    assert [sightings.labels[number] for number in np.flatnonzero(six_terms.outliers)] == ["7", "50", "153"]
    assert np.all(six_terms.weights[six_terms.outliers] < 0.5)


def test_collimation_and_tilt_are_nearly_dependent(six_terms: AxisFit) -> None:
    pairs = {pair[:2]: pair[2] for pair in correlated_pairs(six_terms)}
    assert pairs["c", "I"] < -0.98
    assert [combination.names for combination in near_dependencies(six_terms)] == [("g", "c", "I")]


def test_left_out_is_what_refits_give(sightings: Sightings, six_terms: AxisFit) -> None:
    """The checked sightings are the four with the largest residuals, and two others."""
    for number in [*np.argsort(-sizes(six_terms.residuals))[:4], 0, 1]:
        kept = np.arange(len(sightings.labels)) != number
        others = Sightings(
            tuple(np.array(sightings.labels)[kept]),
            sightings.azimuth[kept],
            sightings.elevation[kept],
            sightings.direction_d[kept],
        )
        refitted = sightings.residuals(fit(others, {"flexure": 0.0}).errors)[number]
        assert np.linalg.norm(refitted - six_terms.leave_one_out[number]) <= 0.3 * ARCSEC


def test_agrees_with_the_observatory(sightings: Sightings) -> None:
    """The observatory's model has c fixed at 0 and a flexure."""
    errors = fit(sightings, {"c": 0.0}).errors
    assert abs(errors.g / ARCSEC + 28.7) <= 1.5
    assert abs(errors.I / ARCSEC + 17.2) <= 1.5
    assert np.hypot(errors.beta_x / ARCSEC, errors.beta_y / ARCSEC + 4.6) <= 2.0


@pytest.mark.parametrize("fixed", [{"flexure": 0.0}, {"c": 0.0}])
def test_multiplied_offsets_are_reported_despite_smaller_residuals(
    sightings: Sightings, fixed: dict[str, float]
) -> None:
    azimuth, elevation = sightings.offsets()
    multiplied = replace(
        sightings,
        direction_d=directions(
            sightings.azimuth + azimuth * np.cos(sightings.elevation), sightings.elevation + elevation
        ),
    )
    assert rms(fit(multiplied, fixed).residuals) < 0.9 * rms(fit(sightings, fixed).residuals)
    assert table_warnings(sightings, fixed) == []
    (text,) = table_warnings(multiplied, fixed)
    assert "already multiplied by cos E" in text
