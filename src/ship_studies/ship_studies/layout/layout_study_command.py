"""``layout_study``: study of star sensor mounting as one page, figures and CSV tables, with the figures of [Z14]."""

import argparse
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import check_folder
from ship_estimation.parameters.schema import describe
from ship_node.pages.study_files import Table, add_study_arguments, study_of_file, write_study
from ship_studies.layout.config import LayoutStudyConfig, study_config
from ship_studies.layout.error_budget import total_arcsec
from ship_studies.layout.field_of_view import PERCENTILES
from ship_studies.layout.installation_model import (
    CURVE_AZIMUTHS_DEG,
    SOURCES,
    SWEEPS,
    InstallationConvention,
    source_errors_arcsec,
)
from ship_studies.layout.requirement_text import REQUIREMENT_TABLES, requirement_lines, requirement_tables
from ship_studies.layout.study import LayoutStudy, compute_study

PAGE = "layout_study.html"
_DEFAULT_TITLE = "two sensors as in [Z14]"

_ERRORS = ("heading_arcsec", "pitch_arcsec", "roll_arcsec")
_SIGMAS = ("heading_sigma_arcsec", "pitch_sigma_arcsec", "roll_sigma_arcsec")

TABLES = (
    *("layout.csv", "error_budget.csv", "error_map.csv", "azimuth_scan.csv"),
    *("sources_at_operating_point.csv", "figures_1_to_6.csv"),
)
"""Names of the tables of every study."""
OPTICS_TABLE = "optics.csv"
"""Name of the table of a study with optics."""

_OPTICS = (
    *("sensor", "field_width_deg", "field_height_deg", "star_sigma_arcsec", "mean_stars"),
    *(f"stars_{percent}_percent" for percent in PERCENTILES),
    *(f"sigma_{axis}_arcsec" for axis in ("forward", "up", "right")),
    *(f"liebe_{axis}_arcsec" for axis in ("forward", "up", "right")),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return run_command(_parser(), _run, arguments)


class _WrappedDescription(argparse.RawDescriptionHelpFormatter):
    """Formatter that wraps the description, and keeps the lines of the table of keys."""

    def add_text(self, text: str | None) -> None:
        """Add a text, wrapped if it contains no line breaks."""
        if text is not None and text is not argparse.SUPPRESS and "\n" not in text:
            text = textwrap.fill(text, max(self._width - self._current_indent, 40))
        super().add_text(text)


def _keys() -> str:
    lines = []
    for key in describe(LayoutStudyConfig):
        default = "must be given" if key.default is None else f"default {key.default:g}"
        lines.append(f"  {key.name:50}{key.unit:8}{default:16}{key.doc}")
    return "\n".join(lines)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="layout_study",
        example="layout.yaml --out study",
        description="Study the mounting of star sensors. Results: errors [arcsec, 1 sigma] of heading, pitch and roll "
        "of all sensors together, by error source and over all directions [deg]; recommended azimuths [deg]; noise of "
        "sensors from their optics [m, px] and the stars of the catalogue over the sky; with a requirement, the "
        "layouts that meet it without obstructions, and the maximum size of each error; and the six figures of [Z14] "
        "in both conventions of its installation angles. Writes layout_study.html (one file with everything), PNG and "
        "CSV.",
        epilog=f"keys of LAYOUT.yaml, nested at the dots (<id>: any name):\n{_keys()}\n\n"
        "exit code: 0 written; 1 written, no layout meets the requirement; 2 bad input or usage; 130 interrupted",
        formatter_class=_WrappedDescription,
    )
    words = "sensors, angles [deg] and errors [arcsec] (default: two sensors with the values of [Z14])"
    add_study_arguments(parser, "LAYOUT.yaml", words)
    return parser


def _run(options: argparse.Namespace) -> int:
    def checked_study(values: Mapping[str, Any]) -> LayoutStudy:
        config = study_config(values)
        check_folder(options.out, output_names(config), options.force)
        return compute_study(config)

    study = study_of_file(options.file, {}, checked_study)
    # The import of matplotlib takes longer than the study, so bad input is reported first.
    from ship_studies.layout.figures import study_figures
    from ship_studies.layout.page import page_text

    title = _DEFAULT_TITLE if options.file is None else options.file.name
    page = partial(page_text, study, title=title)
    write_study(options.out / PAGE, study_tables(study), study_figures(study), page, _summary(study))
    return EXIT_DONE if study.requirement_result is None or study.requirement_result.is_met else EXIT_BOUND_NOT_MET


def output_names(config: LayoutStudyConfig) -> list[str]:
    """Return the names of all files that the command writes."""
    figures = ["layout", "azimuth", *(f"map_{sensor}" for sensor in config.sensors)]
    figures += [f"figure_{sweep.number}" for sweep in SWEEPS]
    tables = [*TABLES, *([OPTICS_TABLE] if config.optics else [])]
    if config.requirement.is_given:
        figures += ["requirement", "elevation"]
        tables += REQUIREMENT_TABLES
    return [PAGE, *tables, *(f"{figure}.png" for figure in figures)]


def _summary(computed: LayoutStudy) -> list[str]:
    lines = [f"{'':24}{'heading':>10}{'pitch':>10}{'roll':>10}{'total':>10}   [arcsec, 1 sigma]"]
    several = len(computed.layout.names) > 1
    alone = [f"{name} alone" for name in computed.layout.names]
    rows = [*zip(alone, computed.alone_arcsec, strict=True)]
    if several:
        rows += [("joint, as given", computed.joint_arcsec), ("joint, recommended", computed.best_arcsec)]
    for words, sigmas in rows:
        lines.append(f"{words:24}" + "".join(f"{value:10.2f}" for value in [*sigmas, total_arcsec(sigmas)]))
    azimuths = ", ".join(
        f"{name} {np.rad2deg(azimuth) % 360.0:.0f}"
        for name, azimuth in zip(computed.best.names, computed.best.angles[:, 0], strict=True)
    )
    if several:
        lines.append(f"recommended azimuths [deg from the bow]: {azimuths}")
    for name, found in computed.optics.items():
        forward, up, right = found.quantile_arcsec
        lines.append(
            f"optics of {name}: {found.stars.mean():.1f} stars on average, "
            f"{found.star_count_percentiles()[5]:.0f} or fewer in "
            f"5 % of the sky; noise about forward, up, right {forward:.2f}, {up:.2f}, {right:.2f} arcsec"
        )
    if computed.requirement_result is not None:
        lines += requirement_lines(computed.requirement_result)
    return lines


def study_tables(study: LayoutStudy) -> dict[str, Table]:
    """Return header and rows of each CSV table."""
    direction = ("azimuth_deg", "elevation_deg")
    tables: dict[str, Table] = {
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
    if study.optics:
        tables[OPTICS_TABLE] = (_OPTICS, _optics(study))
    if study.requirement_result is not None:
        tables |= requirement_tables(study, study.requirement_result)
    return tables


def _layouts(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    given, best = np.rad2deg(study.layout.angles), np.rad2deg(study.best.angles)
    for name, angles, sigmas in zip(study.layout.names, given, study.alone_arcsec, strict=True):
        yield "given", f"{name} alone", *angles[:2], *sigmas, total_arcsec(sigmas)
    yield "given", "joint", "", "", *study.joint_arcsec, total_arcsec(study.joint_arcsec)
    for number, (name, angles) in enumerate(zip(study.best.names, best, strict=True)):
        sigmas = study.best.single_sensor(number).sigmas_arcsec()
        yield "recommended", f"{name} alone", *angles[:2], *sigmas, total_arcsec(sigmas)
    yield "recommended", "joint", "", "", *study.best_arcsec, total_arcsec(study.best_arcsec)


def _optics(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for name, found in study.optics.items():
        stars = (float(found.stars.mean()), *found.star_count_percentiles().values())
        yield name, *found.field_deg, found.star_sigma_arcsec, *stars, *found.quantile_arcsec, *found.liebe_arcsec


def _budget(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for source in study.budget:
        yield source.sensor, source.source, source.sigma_arcsec, *source.errors_arcsec


def _maps(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for moved in study.maps:
        totals = total_arcsec(moved.sigmas_arcsec)
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
    for reading in InstallationConvention:
        for azimuth_deg in CURVE_AZIMUTHS_DEG:
            errors = source_errors_arcsec(point, azimuth_deg, reading)
            for source, size, row in zip(SOURCES, sizes, errors, strict=True):
                yield reading.value, azimuth_deg, source, size, *row


def _curves(study: LayoutStudy) -> Iterator[tuple[Any, ...]]:
    for curve in study.curves:
        azimuth_deg = "" if curve.azimuth_deg is None else curve.azimuth_deg
        for swept_deg, errors in zip(curve.swept_deg, curve.errors_arcsec, strict=True):
            yield curve.sweep.number, curve.convention.value, azimuth_deg, curve.sweep.symbol, swept_deg, *errors
