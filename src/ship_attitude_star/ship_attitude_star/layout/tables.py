"""The numbers of a layout study as CSV files: one table a file, units in the column names."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ship_attitude_star.layout.installation_model import Reading
from ship_attitude_star.layout.joint_error import total_arcsec
from ship_attitude_star.layout.study import LayoutStudy
from ship_attitude_star.layout.sweeps import CURVE_AZIMUTHS_DEG, SOURCES, source_errors_arcsec
from ship_bags.output_files import write_csv

_ERRORS = ("heading_arcsec", "pitch_arcsec", "roll_arcsec")
_SIGMAS = ("heading_sigma_arcsec", "pitch_sigma_arcsec", "roll_sigma_arcsec")

TABLES = (
    *("layout.csv", "error_budget.csv", "error_map.csv", "azimuth_scan.csv"),
    *("sources_at_operating_point.csv", "figures_1_to_6.csv"),
)
"""Names of all files written."""


def write_tables(study: LayoutStudy, folder: Path) -> list[Path]:
    """Write every table into a folder that exists; returns the files."""
    direction = ("azimuth_deg", "elevation_deg")
    tables = {
        "layout.csv": (("layout", "sensor", *direction, *_SIGMAS, "total_arcsec"), _layouts(study)),
        "error_budget.csv": (("sensor", "source", "sigma_arcsec", *_ERRORS), _budget(study)),
        "error_map.csv": (("sensor_moved", *direction, *_SIGMAS, "total_arcsec"), _maps(study)),
        "azimuth_scan.csv": (("sensor_turned", "azimuth_deg", *_SIGMAS, "total_arcsec"), _scans(study)),
        "sources_at_operating_point.csv": (
            ("reading", "installation_azimuth_deg", "source", "error_arcsec", *_ERRORS),
            _sources(study),
        ),
        "figures_1_to_6.csv": (
            ("figure", "reading", "installation_azimuth_deg", "swept_angle", "swept_deg", *_ERRORS),
            _curves(study),
        ),
    }
    return [write_csv(folder / name, header, rows) for name, (header, rows) in tables.items()]


def _layouts(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    given, best = np.rad2deg(study.layout.angles), np.rad2deg(study.best.angles)
    for name, angles, sigmas in zip(study.layout.names, given, study.alone_arcsec, strict=True):
        yield "given", f"{name} alone", *angles[:2], *sigmas, total_arcsec(sigmas)
    yield "given", "joint", "", "", *study.joint_arcsec, total_arcsec(study.joint_arcsec)
    for number, (name, angles) in enumerate(zip(study.best.names, best, strict=True)):
        sigmas = study.best.of_sensor(number).sigmas_arcsec()
        yield "recommended", f"{name} alone", *angles[:2], *sigmas, total_arcsec(sigmas)
    yield "recommended", "joint", "", "", *study.best_arcsec, total_arcsec(study.best_arcsec)


def _budget(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for source in study.budget:
        yield source.sensor, source.source, source.sigma_arcsec, *source.errors_arcsec


def _maps(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for moved in study.maps:
        totals = moved.total_arcsec()
        for row, elevation_deg in enumerate(moved.elevations_deg):
            for column, azimuth_deg in enumerate(moved.azimuths_deg):
                sigmas = moved.sigmas_arcsec[row, column]
                yield moved.sensor, azimuth_deg, elevation_deg, *sigmas, totals[row, column]


def _scans(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for turned in study.scans:
        for azimuth_deg, sigmas in zip(turned.azimuths_deg, turned.sigmas_arcsec, strict=True):
            yield turned.sensor, azimuth_deg, *sigmas, total_arcsec(sigmas)


def _sources(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    point = study.config.figures
    sizes = np.concatenate([point.star_errors_arcsec(), point.installation_errors_arcsec()])
    for reading in Reading:
        for azimuth_deg in CURVE_AZIMUTHS_DEG:
            errors = source_errors_arcsec(point, azimuth_deg, reading)
            for source, size, row in zip(SOURCES, sizes, errors, strict=True):
                yield reading.value, azimuth_deg, source, size, *row


def _curves(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for curve in study.curves:
        azimuth_deg = "" if curve.azimuth_deg is None else curve.azimuth_deg
        for swept_deg, errors in zip(curve.swept_deg, curve.errors_arcsec, strict=True):
            yield curve.sweep.number, curve.reading.value, azimuth_deg, curve.sweep.symbol, swept_deg, *errors
