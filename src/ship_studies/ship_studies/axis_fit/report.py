"""Results of a fit as text for the terminal, as YAML for programs, and as CSV for further evaluation."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import yaml

from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_node.pages.study_files import Table
from ship_studies.axis_fit.diagnostics import condition_number, correlated_pairs, near_dependencies, unobservable
from ship_studies.axis_fit.robust_fit import OUTLIER_AT, AxisFit, rms, sizes
from ship_studies.axis_fit.sightings import Sightings, azimuth_and_elevation, coverage

MEANINGS = {
    "g": "zero point of the azimuth encoder",
    "h": "zero point of the elevation encoder",
    "c": "collimation",
    "I": "tilt of the horizontal axis",
    "beta_x": "tilt of the vertical axis, towards azimuth 0",
    "beta_y": "tilt of the vertical axis, towards azimuth 90",
    "flexure": "bending of the tube, times cos E",
}

_WIDE_GAP = np.pi / 2.0
"""Gap in azimuth above which the tilt of the vertical axis is poorly determined, rad."""


def summary(fit: AxisFit, sightings: Sightings, table_warnings: list[str]) -> str:
    """Return the result as text for the terminal, without a line break at the end."""
    lines = [
        *_coverage(sightings),
        _first_row(sightings),
        *(f"repeated, counted once: observation {repeated}" for repeated in sightings.repeated),
        *(f"warning: {text}" for text in table_warnings),
        "",
        *_terms(fit),
        "",
        *_residuals(fit),
        *_outliers(fit, sightings),
        *_observability_lines(fit),
    ]
    return "\n".join(lines)


def _coverage(sightings: Sightings) -> Iterator[str]:
    found = coverage(sightings)
    low_deg, high_deg = np.rad2deg(found.elevations)
    start_deg, end_deg = np.rad2deg(found.azimuth_gap)
    width_deg = np.rad2deg(found.azimuth_gap_width)
    yield (
        f"{found.count} sightings, {found.plunged} of them plunged; elevations {low_deg:.1f} to {high_deg:.1f} deg; "
        f"widest gap in azimuth {width_deg:.0f} deg ({start_deg:.0f} to {end_deg:.0f})"
        + (": sightings there would help" if found.azimuth_gap_width > _WIDE_GAP else "")
    )


def _first_row(sightings: Sightings) -> str:
    azimuth_deg, elevation_deg = (np.rad2deg(angle[0]) for angle in azimuth_and_elevation(sightings.direction_d))
    return (
        f"read: at {np.rad2deg(sightings.azimuth[0]):.5f}, {np.rad2deg(sightings.elevation[0]):.5f} deg by encoder, "
        f"observation {sightings.labels[0]} has the true direction {azimuth_deg:.5f}, {elevation_deg:.5f} deg. If both "
        "offsets have the wrong sign, all axis errors have the wrong sign too; no sighting can show this"
    )


def _terms(fit: AxisFit) -> Iterator[str]:
    yield f"{'term':8}  {'value':>9} {'sigma':>9}   [arcsec]"
    sigmas = dict(zip(fit.fitted, fit.sigmas / ARCSEC, strict=True))
    for name, value in zip(NAMES, fit.errors.vector() / ARCSEC, strict=True):
        known = f"{sigmas.get(name, 0.0):9.2f}" if fit.sigmas_known else f"{'unknown':>9}"
        sigma = known if name in sigmas else f"{'fixed':>9}"
        # The sum with zero turns a rounded -0.0 into 0.0.
        yield f"{name:8}  {round(float(value), 2) + 0.0:9.2f} {sigma}   {MEANINGS[name]}"
    if not fit.sigmas_known:
        yield (
            f"no sigma: the residuals of neighbouring sightings are correlated ({fit.neighbour_correlation:.2f}), so "
            "they have common errors that the table does not state: columns slow_right_arcsec:NAME:T, "
            "slow_up_arcsec:NAME:T, or group, group_sigma_arcsec"
        )
    elif not np.any(fit.shared):
        yield "sigma: the sightings count as independent; the table states no common error"


def _residuals(fit: AxisFit) -> Iterator[str]:
    yield f"{'residuals':26}{'RMS':>8} {'median':>8}   [arcsec, angle on the sky]"
    for words, residuals in (
        ("without a model", fit.before),
        ("part due to common errors", fit.shared),
        ("with the fitted terms", fit.residuals),
        ("each left out of its fit", fit.leave_one_out),
    ):
        if words == "part due to common errors" and not np.any(residuals):
            continue
        yield f"{words:26}{rms(residuals) / ARCSEC:8.2f} {float(np.median(sizes(residuals))) / ARCSEC:8.2f}"
    if not np.all(fit.outliers):
        yield f"{'without the outliers':26}{rms(fit.residuals[~fit.outliers]) / ARCSEC:8.2f}"


def _outliers(fit: AxisFit, sightings: Sightings) -> Iterator[str]:
    yield f"sigma of one component of a sighting (robust): {fit.scale / ARCSEC:.2f} arcsec"
    numbers = np.flatnonzero(fit.outliers)
    off = sizes(fit.residuals)
    for number in numbers[np.argsort(-off[numbers])]:
        yield (
            f"outlier: observation {sightings.labels[number]}, off by {off[number] / ARCSEC:.1f} arcsec "
            f"({off[number] / fit.scale:.1f} sigma, bound {OUTLIER_AT:g}); weight {fit.weights[number]:.2f}"
        )


def _observability_lines(fit: AxisFit) -> Iterator[str]:
    yield f"condition number: {condition_number(fit):.3g}"
    for first, second, correlation in correlated_pairs(fit):
        yield f"correlated: {first} and {second}, {correlation:+.3f}"
    for combination in near_dependencies(fit):
        runs = changes_text(combination.names, np.array(combination.changes))
        yield (
            f"poorly separated: {', '.join(combination.names)}: {runs} arcsec together (1 sigma) change these "
            f"sightings by only {combination.effect / ARCSEC:.2g} arcsec"
        )
    found = unobservable(fit)
    if found is not None:
        several = f"{found.count} combinations" if found.count > 1 else "one combination"
        what = f"{several} of {', '.join(found.names)}" if len(found.names) > 1 else found.names[0]
        yield f"not observable: {what}; kept near 0. Fix terms, or add sightings where their effects differ"


def changes_text(names: tuple[str, ...], changes: FloatArray) -> str:
    """Return a text of errors with their joint changes: ``c +14.9, I -12.2``."""
    return ", ".join(f"{name} {value / ARCSEC:+.3g}" for name, value in zip(names, changes, strict=True))


FORMAT = "theodolite axis errors"
VERSION = 1

_RESIDUALS = ("before", "after", "left_out")


def fit_tables(fit: AxisFit, sightings: Sightings) -> dict[str, Table]:
    """Return header and rows of each CSV table."""
    names = [f"{residual}_{side}_arcsec" for residual in _RESIDUALS for side in ("right", "up")]
    directions = ("observation", "true_azimuth_deg", "true_elevation_deg")
    return {
        "axes.csv": (("term", "value_arcsec", "sigma_arcsec", "fitted"), _term_rows(fit)),
        "correlation.csv": (("term", *fit.fitted), _correlation_rows(fit)),
        "residuals.csv": ((*directions, *names, "after_arcsec", "weight", "outlier"), _residual_rows(fit, sightings)),
    }


def yaml_text(fit: AxisFit, sightings: Sightings, table_warnings: list[str]) -> str:
    """Return the fit as YAML.

    Args:
        fit: the fit.
        sightings: sightings of the fit.
        table_warnings: warnings about the table that was read.
    """
    values = fit.errors.vector() / ARCSEC
    open_combinations = unobservable(fit)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "values_arcsec": {name: float(value) for name, value in zip(NAMES, values, strict=True)},
        # A sigma from a wrong assumption would be worse than a missing sigma.
        "sigma_arcsec": _sigmas_arcsec(fit) if fit.sigmas_known else None,
        "covariance_of": list(fit.fitted),
        "covariance_rad2": fit.covariance.tolist() if fit.sigmas_known else None,
        "neighbours_correlation": fit.neighbour_correlation,
        "rms_of_shared_errors_arcsec": rms(fit.shared) / ARCSEC,
        "warnings": table_warnings,
        "repeated": list(sightings.repeated),
        "unobservable": list(open_combinations.names) if open_combinations else [],
        "nearly_dependent": [list(combination.names) for combination in near_dependencies(fit)],
        "condition_number": condition_number(fit),
        "sighting_count": len(sightings.labels),
        "outliers": [label for label, outlier in zip(sightings.labels, fit.outliers, strict=True) if outlier],
        "rms_before_arcsec": rms(fit.before) / ARCSEC,
        "rms_after_arcsec": rms(fit.residuals) / ARCSEC,
        "rms_left_out_arcsec": rms(fit.leave_one_out) / ARCSEC,
    }
    return yaml.safe_dump(document, sort_keys=False, width=110, default_flow_style=None)


def _term_rows(fit: AxisFit) -> Iterator[tuple[Any, ...]]:
    sigmas = _sigmas_arcsec(fit) if fit.sigmas_known else {}
    for name, value in zip(NAMES, fit.errors.vector() / ARCSEC, strict=True):
        yield name, value, sigmas.get(name, ""), "yes" if name in fit.fitted else "no"


def _sigmas_arcsec(fit: AxisFit) -> dict[str, float]:
    return dict(zip(fit.fitted, (fit.sigmas / ARCSEC).tolist(), strict=True))


def _correlation_rows(fit: AxisFit) -> Iterator[tuple[Any, ...]]:
    for name, row in zip(fit.fitted, fit.correlation, strict=True):
        yield name, *row


def _residual_rows(fit: AxisFit, sightings: Sightings) -> Iterator[tuple[Any, ...]]:
    azimuth, elevation = np.rad2deg(azimuth_and_elevation(sightings.direction_d))
    residuals = np.concatenate([fit.before, fit.residuals, fit.leave_one_out], axis=1) / ARCSEC
    size = sizes(fit.residuals) / ARCSEC
    for number, label in enumerate(sightings.labels):
        outlier = "yes" if fit.outliers[number] else "no"
        yield label, azimuth[number], elevation[number], *residuals[number], size[number], fit.weights[number], outlier
