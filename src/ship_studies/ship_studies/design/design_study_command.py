"""``design_study``: accuracy of the pointing from beacons on drones, as one page and tables."""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.output_files import check_folder
from ship_geometry.frames import ENU_FROM_HORIZON
from ship_node.pages.study_files import Table, add_study_arguments, study_of_file, write_study
from ship_studies.design.config import W18, study_config
from ship_studies.design.study import DesignStudy, compute_study

PAGE = "design_study.html"
TABLES = ("places.csv", "error_budget.csv", "sweeps.csv")
FIGURES = ("field", "sweeps")
_DEFAULT_TITLE = "two lights as in [W18]"

_SIGMAS = ("azimuth_cos_elevation_arcsec", "elevation_arcsec", "on_sky_arcsec")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="ship_studies",
        prog="design_study",
        example="design.yaml --out study",
        description="Accuracy of the theodolite's pointing from the lights of drones, before the voyage: "
        "error [arcsec, 1 sigma, on the sky] by source, best positions of the drones within limits, and the error "
        "over distance [m] and separation [deg] of the lights, focal length [m], pixel [m], and the errors of lever, "
        "RTK and N' [m]. Writes design_study.html (one file with everything), PNG and CSV.",
        epilog="DESIGN.yaml; keys shown with dots have no default:\n"
        "  azimuth_deg: 90.0, elevation_deg: 30.0          of the pointing, from the bow, over the horizon\n"
        "  ship_heading_sigma_arcsec: 2.0, ship_tilt_sigma_arcsec: 1.5    error of ship/attitude\n"
        "  pixel_pitch_m: 6.5e-6, centroid_sigma_px: 0.1   of the telescope's detector, of a light's image\n"
        "  required_arcsec: 0.0                            required error with the given lights; 0: none\n"
        "  lights: {a: {right_deg: ..., up_deg: ..., distance_m: ...}}    relative to the telescope's axis\n"
        "  optical_axis: {...}     parameters of the node optical_axis, beacons and the limits escort.* among them\n"
        "\nexit code: 0 written; 1 written, but the given lights exceed required_arcsec; 2 bad input or "
        "usage; 130 interrupted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_study_arguments(parser, "DESIGN.yaml", "theodolite, drones and limits (default: the values of [W18])")
    return parser


def _run(options: argparse.Namespace) -> int:
    def checked_study(values: Mapping[str, Any]) -> DesignStudy:
        config = study_config(values)
        check_folder(options.out, output_names(), options.force)
        return compute_study(config)

    study = study_of_file(options.file, W18, checked_study)
    # Imported here, so that bad input is reported before the figures' library is loaded.
    from ship_studies.design.page import page_text, study_figures

    page = partial(page_text, study, title=_DEFAULT_TITLE if options.file is None else options.file.name)
    write_study(options.out / PAGE, study_tables(study), study_figures(study), page, _summary(study))
    return EXIT_DONE if study.meets_requirement else EXIT_BOUND_NOT_MET


def output_names() -> list[str]:
    """Return the names of all files written."""
    return [PAGE, *TABLES, *(f"{figure}.png" for figure in FIGURES)]


def _summary(computed: DesignStudy) -> list[str]:
    lines = [f"{'':28}{'azimuth cos E':>14}{'elevation':>12}{'on the sky':>12}   [arcsec, 1 sigma]"]
    for words, sigmas in (("given lights", computed.given_arcsec), ("best positions", computed.advised_arcsec)):
        azimuth, elevation, on_sky = sigmas
        lines.append(f"{words:28}{azimuth:14.2f}{elevation:12.2f}{on_sky:12.2f}")
    lines.append(f"{'encoders and ship alone':28}{'':26}{computed.unaided_arcsec:12.2f}")
    reached = computed.advice.limits_reached
    if reached:
        lines.append(f"limits reached: {'; '.join(reached)}")
    if not computed.meets_requirement:
        lines.append(f"required {computed.config.required_arcsec:g} arcsec on the sky: not met")
    return lines


def study_tables(study: DesignStudy) -> dict[str, Table]:
    """Return header and rows of each CSV table."""
    place = ("right_deg", "up_deg", "distance_m", "east_m", "north_m", "up_m")
    return {
        "places.csv": (("places", "beacon", *place, "limits_reached"), _places(study)),
        "error_budget.csv": (("places", "source", *_SIGMAS), _budget(study)),
        "sweeps.csv": (("quantity", "value", "unit", "as_given_arcsec", "best_places_arcsec"), _sweeps(study)),
    }


def _places(study: DesignStudy) -> Iterator[tuple[Any, ...]]:
    both = (("given", study.given_n), ("best", study.advice.places_n))
    for number, (words, places_n) in enumerate(both):
        for light, name in enumerate(study.config.names):
            reached = [limit for limit in study.advice.limits_reached if name in limit.split(":")[0].split(", ")]
            yield (
                words,
                name,
                *study.places_deg[number, light],
                study.distances_m[number, light],
                *(ENU_FROM_HORIZON @ places_n[light]),
                "" if words == "given" else "; ".join(reached),
            )


def _budget(study: DesignStudy) -> Iterator[tuple[Any, ...]]:
    for source in study.budget:
        yield "given", source.source, *source.given_arcsec
    yield "given", "root sum of squares", *study.given_arcsec
    for source in study.budget:
        yield "best", source.source, *source.advised_arcsec
    yield "best", "root sum of squares", *study.advised_arcsec


def _sweeps(study: DesignStudy) -> Iterator[tuple[Any, ...]]:
    for sweep in study.sweeps:
        for value, as_given, best in zip(sweep.values, sweep.sigma_arcsec, sweep.best_arcsec, strict=True):
            yield sweep.name, f"{value:.6g}", sweep.unit, as_given, best
