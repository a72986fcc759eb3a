"""``triangulate``: positions of a target from the recorded directions of several theodolites.

The file of the command has the parameters of the node ``triangulation``, and for each theodolite a bag with its
directions.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ship_bags.command_line import EXIT_BOUND_NOT_MET, EXIT_DONE, CommandParser, run_command
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import read_bag, with_bag_progress
from ship_bags.output_files import add_force_option, check_file, write_csv
from ship_bags.parameter_yaml import read_nested_parameters
from ship_bags.stamps import END_OF_TIME_NS, utc_text
from ship_estimation.parameters.fields import mapping_of, parameter
from ship_estimation.parameters.schema import ParameterError, build
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Status
from ship_node.messages.field_checks import MessageRejected
from theodolite_calib.messages.input_messages import direction
from theodolite_calib.messages.output_messages import TARGET_TYPE
from theodolite_calib.triangulation.triangulation import (
    DIRECTION_TOPIC,
    PositioningConfig,
    StationPositionConfig,
    TriangulatedPosition,
)
from theodolite_calib.triangulation.triangulation_core import (
    DirectionSample,
    StationDirections,
    TargetPosition,
    is_leading,
    position_at,
)

COLUMNS = (
    *("utc", "east_m", "north_m", "up_m", "sigma_east_m", "sigma_north_m", "sigma_up_m"),
    *("cov_east_north_m2", "cov_east_up_m2", "cov_north_up_m2", "chi_square", "gate", "fits", "status", "stations"),
)
"""Columns of the table that is written."""

_EAST_NORTH_UP = [2, 0, 1]
"""Indices of East, North, Up in (North, Up, East)."""


@dataclass(frozen=True, kw_only=True)
class RecordedStationConfig(StationPositionConfig):
    """One theodolite: its position, and the bag with its directions."""

    bag: str = parameter(doc="bag with its directions; a relative path starts at the file")
    topic: str = parameter(DIRECTION_TOPIC, doc="topic of ship_msgs/msg/TargetDirection in that bag")


@dataclass(frozen=True, kw_only=True)
class RecordedTriangulationConfig(PositioningConfig):
    """All parameters of the file."""

    stations: dict[str, RecordedStationConfig] = mapping_of("theodolites by name, two or more")


def read_directions(folder: Path, config: RecordedTriangulationConfig, target_id: str) -> list[StationDirections]:
    """Return the recorded directions of each theodolite to a target, without unusable directions.

    If two directions have the same stamp, the first is used.

    Raises:
        BadInput: a bag cannot be read, lacks the configured topic, or has no direction of the target.
    """
    recorded = []
    for name, station in config.stations.items():
        directions = StationDirections(station.station(name), config.max_gap_s)
        for sample in _recorded_directions(folder / station.bag, station.topic, name, target_id):
            if directions.track.get(sample.time_ns) is None:
                directions.track.insert(sample)
        recorded.append(directions)
    return recorded


def target_positions(config: PositioningConfig, recorded: Sequence[StationDirections]) -> Iterator[TargetPosition]:
    """Yield position or rejection at each stamp of a leading theodolite; a position needs two directions."""
    stamps = [(time_ns, number) for number, seen in enumerate(recorded) for time_ns in seen.track.times_ns]
    for time_ns, number in sorted(stamps):
        if is_leading(number, time_ns, recorded):
            yield position_at(time_ns, recorded, config)


def _recorded_directions(path: Path, topic: str, station: str, target_id: str) -> list[DirectionSample]:
    found, others = [], set()
    with read_bag(path) as bag:
        if bag.topics.get(topic) != TARGET_TYPE:
            there = ", ".join(sorted(name for name, kind in bag.topics.items() if kind == TARGET_TYPE)) or "none"
            raise BadInput(f"has no topic '{topic}' of {TARGET_TYPE} (of that type it has: {there})", file=path)
        for record in with_bag_progress(bag.records([topic]), bag):
            message = record.decode()
            try:
                sample = direction(message, station, END_OF_TIME_NS).value
            except MessageRejected:
                continue
            if sample.target_id != target_id:
                others.add(sample.target_id)
            else:
                found.append(sample)
    if all(sample.status is Status.INVALID for sample in found):
        there = ", ".join(sorted(others)) or "none"
        raise BadInput(f"topic '{topic}' has no direction of target '{target_id}' (other targets: {there})", file=path)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(_parser(), _run, arguments)


def _parser() -> CommandParser:
    parser = CommandParser(
        package="theodolite_calib",
        prog="triangulate",
        example="stations.yaml --target buoy --out places.csv",
        description="Positions of a target [m, East, North, Up from a stated origin] with covariance [m^2], from the "
        "recorded directions to it (theodolite/target_direction) of two or more theodolites, at each stamp of the "
        "first one in the file that sees it at that time.",
        epilog="the file, angles in degrees, lengths in metres:\n"
        "  origin: {latitude_deg: 31.9452, longitude_deg: 120.2931, height_m: 20.0}\n"
        "  stations:\n"
        "    east: {bag: east.mcap, latitude_deg: 31.9452, longitude_deg: 120.2931, height_m: 21.0, sigma_m: 0.05}\n"
        "    west: {bag: west.mcap, topic: /west/theodolite/target_direction, latitude_deg: ...}\n"
        "  refraction: {coefficient: 0.13, sigma: 0.06}   coefficient k of terrestrial refraction, the default\n"
        "  max_gap_s: 1.0, gate_probability: 0.999        the defaults\n"
        "columns written: " + ", ".join(COLUMNS) + "\n"
        "status: the worst of the directions used (valid, coasting, degraded); fits: 1 if they are consistent\n"
        "exit code: 0 written; 1 written, but some sets of directions are inconsistent; 2 bad input or usage; "
        "130 interrupted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("stations", type=Path, metavar="STATIONS.yaml", help="theodolites, their positions and bags")
    parser.add_argument("--target", required=True, metavar="ID", help="target_id of the directions")
    parser.add_argument("--out", type=Path, required=True, metavar="PLACES.csv", help="table to write")
    add_force_option(parser)
    return parser


def _run(options: argparse.Namespace) -> int:
    check_file(options.out, options.force)
    config = _configuration(options.stations)
    recorded = read_directions(options.stations.parent, config, options.target)
    found = list(target_positions(config, recorded))
    positions = [(one, one.position) for one in found if isinstance(one.position, TriangulatedPosition)]
    # Times with one direction only are not reported.
    rejected = [one.position for one in found if isinstance(one.position, Rejection) and len(one.stations) > 1]
    why = f", the first one because {rejected[0].text}" if rejected else ""
    if not positions:
        names = ", ".join(config.stations)
        text = f"no position of '{options.target}': no two directions of {names} at one time intersect"
        raise BadInput(f"{text} (max_gap_s = {config.max_gap_s:g}){why}", file=options.stations)
    write_csv(options.out, COLUMNS, _rows(positions))
    misfits = sum(place.rejection is not None for _, place in positions)
    sigma_m = np.sqrt(np.median([np.trace(place.covariance_n) for _, place in positions]))
    sys.stdout.write(
        f"{options.out}: {len(positions)} positions of '{options.target}', error {sigma_m:.3g} m (1 sigma in space, "
        f"median), {misfits} with inconsistent directions\n"
    )
    if rejected:
        sys.stdout.write(f"at {len(rejected)} further times the directions give no position{why}\n")
    return EXIT_BOUND_NOT_MET if misfits else EXIT_DONE


def _configuration(path: Path) -> RecordedTriangulationConfig:
    """Return the checked configuration in a file.

    Raises:
        BadInput: the configuration cannot be used.
    """
    file = read_nested_parameters(path)
    try:
        config = build(RecordedTriangulationConfig, file.values)
    except ParameterError as problem:
        raise file.error(problem) from problem
    if len(config.stations) < 2:
        raise BadInput(f"'stations' has {len(config.stations)}: a position needs two theodolites or more", file=path)
    return config


def _rows(positions: Sequence[tuple[TargetPosition, TriangulatedPosition]]) -> Iterator[list[str | float | int]]:
    for one, found in positions:
        place = found.position_n[_EAST_NORTH_UP]
        covariance = found.covariance_n[np.ix_(_EAST_NORTH_UP, _EAST_NORTH_UP)]
        lengths_m = [*place, *np.sqrt(covariance.diagonal())]
        products_m2 = [covariance[0, 1], covariance[0, 2], covariance[1, 2]]
        yield [
            utc_text(one.time_ns),
            *(f"{length_m:.4f}" for length_m in lengths_m),
            *(f"{product_m2:.6g}" for product_m2 in products_m2),
            f"{found.chi_square:.2f}",
            f"{found.gate:.2f}",
            int(found.rejection is None),
            one.status.name.lower(),
            " ".join(one.stations),
        ]
