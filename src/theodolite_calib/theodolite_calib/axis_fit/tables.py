"""What a fit found as files: YAML for programs, CSV for people's own evaluations. Units stand in the names."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ship_bags.output_files import write_csv, write_whole
from ship_geometry.rotations import ARCSEC
from theodolite_calib.axis_fit.coverage import azimuth_and_elevation
from theodolite_calib.axis_fit.robust_fit import AxisFit, rms, sizes
from theodolite_calib.axis_fit.sightings import Sightings
from theodolite_calib.axis_fit.told_apart import condition_number, poorly_told_apart, unobservable
from theodolite_calib.chain.axes import NAMES

FORMAT = "theodolite axis errors"
VERSION = 1

_RESIDUALS = ("before", "after", "left_out")


def write_tables(fit: AxisFit, sightings: Sightings, doubted: list[str], folder: Path) -> list[Path]:
    """Write every table into a folder that exists; returns the files.

    Args:
        fit: what was found.
        sightings: from what.
        doubted: what speaks against the table as it was read.
        folder: where.
    """
    names = [f"{residual}_{side}_arcsec" for residual in _RESIDUALS for side in ("right", "up")]
    return [
        _write_yaml(folder / "axes.yaml", fit, sightings, doubted),
        write_csv(folder / "axes.csv", ("term", "value_arcsec", "sigma_arcsec", "fitted"), _terms(fit)),
        write_csv(folder / "correlation.csv", ("term", *fit.fitted), _correlation(fit)),
        write_csv(
            folder / "residuals.csv",
            ("observation", "true_azimuth_deg", "true_elevation_deg", *names, "after_arcsec", "weight", "outlier"),
            _residuals(fit, sightings),
        ),
    ]


def _write_yaml(path: Path, fit: AxisFit, sightings: Sightings, doubted: list[str]) -> Path:
    values = fit.errors.vector() / ARCSEC
    open_combinations = unobservable(fit)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "values_arcsec": {name: float(value) for name, value in zip(NAMES, values, strict=True)},
        # Nothing rather than sigmas of a wrong assumption.
        "sigma_arcsec": _sigmas_arcsec(fit) if fit.sigmas_known else None,
        "covariance_of": list(fit.fitted),
        "covariance_rad2": fit.covariance.tolist() if fit.sigmas_known else None,
        "neighbours_correlation": fit.neighbours,
        "rms_of_shared_errors_arcsec": rms(fit.shared) / ARCSEC,
        "doubts": doubted,
        "given_again": list(sightings.repeated),
        "unobservable": list(open_combinations.names) if open_combinations else [],
        "poorly_told_apart": [list(combination.names) for combination in poorly_told_apart(fit)],
        "condition_number": condition_number(fit),
        "sighting_count": len(sightings.labels),
        "outliers": [label for label, outlier in zip(sightings.labels, fit.outliers, strict=True) if outlier],
        "rms_before_arcsec": rms(fit.before) / ARCSEC,
        "rms_after_arcsec": rms(fit.residuals) / ARCSEC,
        "rms_left_out_arcsec": rms(fit.left_out) / ARCSEC,
    }
    write_whole(path, yaml.safe_dump(document, sort_keys=False, width=110, default_flow_style=None))
    return path


def _terms(fit: AxisFit) -> Iterator[tuple[Any, ...]]:
    sigmas = _sigmas_arcsec(fit) if fit.sigmas_known else {}
    for name, value in zip(NAMES, fit.errors.vector() / ARCSEC, strict=True):
        yield name, value, sigmas.get(name, ""), "yes" if name in fit.fitted else "no"


def _sigmas_arcsec(fit: AxisFit) -> dict[str, float]:
    return dict(zip(fit.fitted, (fit.sigmas / ARCSEC).tolist(), strict=True))


def _correlation(fit: AxisFit) -> Iterator[tuple[Any, ...]]:
    for name, row in zip(fit.fitted, fit.correlation, strict=True):
        yield name, *row


def _residuals(fit: AxisFit, sightings: Sightings) -> Iterator[tuple[Any, ...]]:
    azimuth, elevation = np.rad2deg(azimuth_and_elevation(sightings.direction_d))
    residuals = np.concatenate([fit.before, fit.residuals, fit.left_out], axis=1) / ARCSEC
    size = sizes(fit.residuals) / ARCSEC
    for number, label in enumerate(sightings.labels):
        outlier = "yes" if fit.outliers[number] else "no"
        yield label, azimuth[number], elevation[number], *residuals[number], size[number], fit.weights[number], outlier
