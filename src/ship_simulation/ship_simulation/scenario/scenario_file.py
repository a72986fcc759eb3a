"""Reads scenario files; what is wrong with one is said with file, line, key and what was expected."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import ParameterFile, read_plain
from ship_estimation.parameters import ParameterError, build
from ship_geometry.earth_orientation import earth_orientation_table
from ship_geometry.time_scales import DAY_NS
from ship_simulation.draws.noise import SECOND_NS
from ship_simulation.faults.faults import KINDS_WITH_DELAY, can_happen
from ship_simulation.scenario.motion_scenario import SECTIONS_OF_KIND, CarrierMotion, window_problems
from ship_simulation.scenario.names import simulated_topics
from ship_simulation.scenario.scenario import Scenario, StarSensor, start_of
from ship_simulation.scenario.theodolite_scenario import SECTIONS_OF_FLIGHT, Beacon

FIELDS_OF_OUTPUTS = {
    ("horizon_attitude",): ("common_sigma_arcsec", "common_time_s", "star_count"),
    ("observations",): (
        "camera",
        "magnitude_limit",
        "most_stars",
        "exposure_s",
        "identified",
        "direction_given",
        "false_stars",
        "swapped_probability",
    ),
    ("horizon_attitude", "inertial_attitude"): ("sigma_forward_arcsec", "sigma_up_arcsec", "sigma_right_arcsec"),
    ("observations", "inertial_attitude"): ("sun_limit_deg",),
}
"""Outputs of a star sensor, and the fields that belong to these only."""


def load_scenario(path: Path | str, recording: Path | None = None) -> Scenario:
    """The checked scenario of a file.

    Args:
        path: YAML file.
        recording: bag to follow instead of the one that the file names.

    Raises:
        BadInput: names file, line, key, value and what was expected.
    """
    file = read_plain(Path(path))
    try:
        scenario = build(Scenario, file.values)
    except ParameterError as problem:
        raise file.error(problem) from problem
    if recording is not None and scenario.carrier.kind != "recorded":
        raise _error(file, "'carrier.kind' must be recorded to follow a recording")
    scenario = _with_recording(scenario, Path(path).parent, recording)
    for text in _problems(scenario, file):
        raise _error(file, text)
    return scenario


def _error(file: ParameterFile, text: str) -> BadInput:
    _, key, _ = text.split("'", 2)
    return file.error(ParameterError(text, key))


def _with_recording(scenario: Scenario, folder: Path, recording: Path | None) -> Scenario:
    """The scenario with the place of the recorded motion seen from the current folder."""
    named = scenario.carrier.recording.bag
    bag = str(recording) if recording is not None else str(folder / named) if named else ""
    moved: CarrierMotion = dataclasses.replace(
        scenario.carrier, recording=dataclasses.replace(scenario.carrier.recording, bag=bag)
    )
    return dataclasses.replace(scenario, carrier=moved)


def _problems(scenario: Scenario, file: ParameterFile) -> Iterator[str]:
    """What no single value shows; each text begins with the key."""
    try:
        start_of(scenario.start_utc)
    except ValueError as problem:
        yield f"'start_utc' = {scenario.start_utc} is not a moment such as 2014-07-09T11:50:07.8Z: {problem}"
    yield from _carrier_problems(scenario.carrier, file)
    for sensor_id, sensor in scenario.star_sensors.items():
        for name, outage in sensor.outages.items():
            yield from window_problems(f"star_sensors.{sensor_id}.outages.{name}", outage.start_s, outage.end_s)
        yield from _output_problems(f"star_sensors.{sensor_id}", sensor, file.values["star_sensors"][sensor_id])
    yield from theodolite_problems(scenario, file.values)
    yield from _fault_problems(scenario)
    if scenario.needs_sky:
        yield from _sky_problems(scenario)


def _carrier_problems(carrier: CarrierMotion, file: ParameterFile) -> Iterator[str]:
    used = SECTIONS_OF_KIND[carrier.kind]
    for group in file.values["carrier"]:
        if group not in ("kind", *used):
            yield f"'carrier.{group}' is not used by a carrier of kind {carrier.kind}: expected {', '.join(used)}"
    if carrier.kind == "recorded" and not Path(carrier.recording.bag).exists():
        named = carrier.recording.bag or "not given"
        yield f"'carrier.recording.bag' = {named} is not there: expected a bag with {carrier.recording.topic}"


def _output_problems(key: str, sensor: StarSensor, given: Mapping[str, Any]) -> Iterator[str]:
    for outputs, fields in FIELDS_OF_OUTPUTS.items():
        for field in fields:
            if field in given and sensor.output not in outputs:
                yield f"'{key}.{field}' is not used with output {sensor.output}: it belongs to {' or '.join(outputs)}"
    if sensor.output != "observations":
        return
    try:
        sensor.camera.camera(f"{key}.camera")
    except ParameterError as problem:
        yield str(problem)
    if not (sensor.camera.width_px and sensor.camera.height_px):
        yield f"'{key}.camera.width_px' and '{key}.camera.height_px' must be given: they are the field of view"
    if sensor.direction_given and not sensor.identified:
        yield f"'{key}.direction_given' needs identified stars: leave one of the two out"


def _sky_problems(scenario: Scenario) -> Iterator[str]:
    start_ns = start_of(scenario.start_utc)
    ends_ns = np.array([start_ns, start_ns + round(scenario.duration_s * SECOND_NS)])
    # A day more, so that no time offset leaves the table.
    reason = earth_orientation_table().reason_against(ends_ns + np.array([-DAY_NS, DAY_NS]))
    if reason is not None:
        yield f"'start_utc' = {scenario.start_utc} cannot be given a sky: {reason}"


def _fault_problems(scenario: Scenario) -> Iterator[str]:
    topics = simulated_topics(scenario)
    for name, fault in scenario.faults.items():
        yield from window_problems(f"faults.{name}", fault.start_s, fault.end_s)
        if fault.topic not in topics:
            yield f"'faults.{name}.topic' = {fault.topic} is not simulated: expected one of {', '.join(topics)}"
        if not can_happen(fault.kind, topics[fault.topic]):
            yield f"'faults.{name}.kind' = {fault.kind} cannot happen to {topics[fault.topic]}"
        if (fault.kind in KINDS_WITH_DELAY) != (fault.delay_s > 0.0):
            kinds = " and ".join(KINDS_WITH_DELAY)
            yield f"'faults.{name}.delay_s' must be positive with the kinds {kinds}, and not given with another"


def theodolite_problems(scenario: Scenario, given: Mapping[str, Any]) -> Iterator[str]:
    """The problems of a scenario; ``given`` is what its file holds."""
    if not scenario.theodolite.aboard:
        for group in ("theodolite", "beacons"):
            if given.get(group):
                yield f"'{group}' is not used without 'theodolite.aboard: true'"
        return
    programme = scenario.theodolite.programme
    if programme.greatest_elevation_deg < programme.least_elevation_deg:
        yield (
            f"'theodolite.programme.greatest_elevation_deg' = {programme.greatest_elevation_deg} deg must not be "
            f"less than least_elevation_deg = {programme.least_elevation_deg} deg"
        )
    for beacon_id, beacon in scenario.beacons.items():
        yield from _beacon_problems(f"beacons.{beacon_id}", beacon, given["beacons"][beacon_id].get("flight", {}))


def _beacon_problems(key: str, beacon: Beacon, flight: Mapping[str, Any]) -> Iterator[str]:
    kind = beacon.flight.kind
    for group in SECTIONS_OF_FLIGHT.values():
        if group in flight and group != SECTIONS_OF_FLIGHT[kind]:
            yield f"'{key}.flight.{group}' is not used by a flight of kind {kind}: expected {SECTIONS_OF_FLIGHT[kind]}"
    moments = [waypoint.time_s for waypoint in beacon.flight.waypoints.values()]
    if kind == "legs" and len(set(moments)) < max(2, len(moments)):
        yield f"'{key}.flight.waypoints' must be two or more with different time_s, got {moments}"
    windows = {"hidden": beacon.hidden, "rtk.float_times": beacon.rtk.float_times}
    windows |= {"rtk.no_solution_times": beacon.rtk.no_solution_times, "rtk.outages": beacon.rtk.outages}
    for group, named in windows.items():
        for name, window in named.items():
            yield from window_problems(f"{key}.{group}.{name}", window.start_s, window.end_s)
