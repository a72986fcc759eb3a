"""Reading of scenario files and fault files; an error states file, line, key and the expected value.

Faults are checked against the topics of the scenario or of a bag.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from ship_bags.message_store import message_store
from ship_bags.parameter_yaml import ParameterFile, read_nested_parameters
from ship_estimation.parameters.fields import mapping_of
from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.earth.earth_orientation import earth_orientation_table
from ship_geometry.earth.time_scales import DAY_NS, SECOND_NS
from ship_simulation.scenario.fault import Fault, size_problems
from ship_simulation.scenario.motion_scenario import SECTIONS_OF_KIND, CarrierMotion, Outage
from ship_simulation.scenario.names import FIRST_VALUE, TELESCOPE_ID, is_applicable, simulated_topics
from ship_simulation.scenario.scenario import Scenario, StarImaging, StarSensor, start_time_ns
from ship_simulation.scenario.theodolite_scenario import SECTIONS_OF_COURSE, Beacon, Course
from ship_stars.sky.deck_masks import check_field_not_covered, sensor_masks

_STEP = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,6}|\*)\])?")
_NO_NUMBERS = ("string", "wstring", "bool")
_NESTED = {Nodetype.ARRAY, Nodetype.SEQUENCE}

FIELDS_OF_OUTPUTS = {
    ("horizon_attitude",): ("common_sigma_arcsec", "common_time_s", "star_count"),
    ("observations",): (
        "camera",
        "magnitude_limit",
        "masks",
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
"""Outputs of a star sensor → fields that belong only to sensors with one of these outputs."""


@dataclass(frozen=True)
class FaultFile:
    """Content of a file of faults."""

    faults: dict[str, Fault] = mapping_of("faults by name")


def load_faults(source: Path | str, topics: Mapping[str, str], location: str) -> dict[str, Fault]:
    """Return the checked faults of a file.

    Args:
        source: YAML file with a group ``faults`` as in a scenario; a ``str`` is the text itself.
        topics: topic → type of the topics that faults may affect.
        location: words for the location of these topics in an error, as ``in the bag``.

    Raises:
        BadInput: the file is invalid; the error states file, line, key, value and the expected value.
    """
    file = read_nested_parameters(source)
    try:
        faults = build(FaultFile, file.values).faults
        if not faults:
            raise ParameterError("parameter 'faults' must be a group with at least one fault", "faults")
        for problem in fault_problems(faults, topics, location):
            raise problem
    except ParameterError as problem:
        raise file.error(problem) from problem
    return faults


def fault_problems(faults: Mapping[str, Fault], topics: Mapping[str, str], location: str) -> Iterator[ParameterError]:
    """Yield the inconsistencies of faults whose single values are valid."""
    for name, fault in faults.items():
        key = f"faults.{name}"
        yield from size_problems(key, fault)
        if fault.topic not in topics:
            known = ", ".join(topics)
            text = f"'{key}.topic' = {fault.topic} is not {location}: expected one of {known}"
            yield ParameterError(text, f"{key}.topic")
            continue
        type_name = topics[fault.topic]
        if not is_applicable(fault.kind, type_name):
            yield ParameterError(f"'{key}.kind' = {fault.kind} does not apply to {type_name}", f"{key}.kind")
        if "field" in fault.sizes:
            problem = _field_problem(fault, type_name)
            if problem:
                yield ParameterError(f"'{key}.field' = {fault.field}: {problem}", f"{key}.field")


def field_steps(path: str) -> list[tuple[str, str]]:
    """Return (name, index) of each part of a field's path; the index is a number, ``*`` or empty.

    Raises:
        ValueError: the text is not a path.
    """
    parts = [_STEP.fullmatch(part) for part in path.split(".")]
    if any(part is None for part in parts):
        raise ValueError("not a field path such as orientation.x, covariance[4], stars[*].u")
    return [(part[1], part[2] or "") for part in parts if part is not None]


def numeric_fields(type_name: str) -> dict[str, str]:
    """Return path → type (``float64``) of each number in a message; a list or array has its first element only."""
    found: dict[str, str] = {}
    fields: dict[str, Any] = dict(message_store().fielddefs[type_name][1])
    for name, (node, content) in fields.items():
        path = name
        if node in _NESTED:
            (node, content), path = content[0], f"{name}[0]"
        if node == Nodetype.NAME:
            found |= {f"{path}.{inner}": base for inner, base in numeric_fields(content).items()}
        elif content[0] not in _NO_NUMBERS:
            found[path] = content[0]
    return found


def _field_problem(fault: Fault, type_name: str) -> str:
    """Return the reason why a fault's field cannot be set to a number; empty if it can be set."""
    if not fault.field:
        return "" if type_name in FIRST_VALUE else f"must be given for {type_name}"
    try:
        base = _base_type(field_steps(fault.field), type_name)
    except ValueError as problem:
        return str(problem)
    if base.startswith("float"):
        largest = float(np.finfo(base).max)
        fits = abs(fault.value) <= largest
        return "" if fits else f"value = {fault.value:g} is too large: the maximum of {base} is {largest:g}"
    if fault.kind != "corrupt":
        return f"an integer field ({base}) allows no NaN, infinity or offset: use corrupt"
    limits = np.iinfo(base)
    if not (fault.value.is_integer() and limits.min <= fault.value <= limits.max):
        return f"value = {fault.value:g} is out of range: expected an integer from {limits.min} to {limits.max}"
    return ""


def _base_type(steps: list[tuple[str, str]], type_name: str) -> str:
    """Return the type of the number at a path.

    Raises:
        ValueError: there is no number at the path.
    """
    for number, (name, index) in enumerate(steps):
        fields: dict[str, Any] = dict(message_store().fielddefs[type_name][1])
        if name not in fields:
            raise ValueError(f"{type_name} has no field {name}: expected one of {', '.join(fields)}")
        node, content = fields[name]
        if node in _NESTED:
            (node, content), length = content
            if node == Nodetype.BASE and not index:
                raise ValueError(f"{name} has several elements: expected {name}[0] or {name}[*]")
            if index.isdecimal() and 0 < length <= int(index):
                raise ValueError(f"{name} has {length} elements, starting at 0")
        elif index:
            raise ValueError(f"{name} is a single value: expected no [{index}]")
        last = number + 1 == len(steps)
        if node == Nodetype.NAME and not last:
            type_name = content
        elif node == Nodetype.NAME or not last or content[0] in _NO_NUMBERS:
            raise ValueError("not the path of a number")
        else:
            return str(content[0])
    raise ValueError("not the path of a number")


def load_scenario(path: Path | str, recording: Path | None = None) -> Scenario:
    """Return the checked scenario of a file.

    Args:
        path: YAML file.
        recording: bag with the motion, in place of the bag that the file names.

    Raises:
        BadInput: the file is invalid; the error states file, line, key, value and the expected value.
    """
    file = read_nested_parameters(Path(path))
    try:
        scenario = build(Scenario, file.values)
    except ParameterError as problem:
        raise file.error(problem) from problem
    if recording is not None and scenario.carrier.kind != "recorded":
        raise file.error(_parameter_error("carrier.kind", "must be recorded to follow a recording"))
    scenario = _with_recording(scenario, Path(path).parent, recording)
    for wrong in _problems(scenario, file):
        raise file.error(wrong)
    return scenario


def _parameter_error(key: str, text: str) -> ParameterError:
    return ParameterError(f"'{key}' {text}", key)


def _with_recording(scenario: Scenario, folder: Path, recording: Path | None) -> Scenario:
    """Return the scenario with the bag of its motion: ``recording``, or else the named bag, relative to ``folder``."""
    named = scenario.carrier.recording.bag
    bag = str(recording) if recording is not None else str(folder / named) if named else ""
    moved: CarrierMotion = dataclasses.replace(
        scenario.carrier, recording=dataclasses.replace(scenario.carrier.recording, bag=bag)
    )
    return dataclasses.replace(scenario, carrier=moved)


def _problems(scenario: Scenario, file: ParameterFile) -> Iterator[ParameterError]:
    """Yield the inconsistencies of a scenario whose single values are valid."""
    try:
        start_time_ns(scenario.start_utc)
    except ValueError as problem:
        yield _parameter_error(
            "start_utc", f"= {scenario.start_utc} is not a time such as 2014-07-09T11:50:07.8Z: {problem}"
        )
    yield from _carrier_problems(scenario.carrier, file)
    for sensor_id, sensor in scenario.star_sensors.items():
        yield from _windows_problems(f"star_sensors.{sensor_id}.outages", sensor.outages)
        yield from _output_problems(f"star_sensors.{sensor_id}", sensor, file.values["star_sensors"][sensor_id])
    yield from _theodolite_problems(scenario, file.values)
    yield from fault_problems(scenario.faults, simulated_topics(scenario), "simulated")
    if scenario.has_sky:
        yield from _sky_problems(scenario)


def _carrier_problems(carrier: CarrierMotion, file: ParameterFile) -> Iterator[ParameterError]:
    used = SECTIONS_OF_KIND[carrier.kind]
    for group in file.values["carrier"]:
        if group not in ("kind", *used):
            expected = ", ".join(used)
            yield _parameter_error(
                f"carrier.{group}", f"is not used by a carrier of kind {carrier.kind}: expected {expected}"
            )
    if carrier.kind == "recorded" and not Path(carrier.recording.bag).exists():
        named = carrier.recording.bag or "not given"
        yield _parameter_error(
            "carrier.recording.bag", f"= {named} is missing: expected a bag with {carrier.recording.topic}"
        )


def _output_problems(key: str, sensor: StarSensor, given: Mapping[str, Any]) -> Iterator[ParameterError]:
    for outputs, fields in FIELDS_OF_OUTPUTS.items():
        for field in fields:
            if field in given and sensor.output not in outputs:
                owners = " or ".join(outputs)
                yield _parameter_error(
                    f"{key}.{field}", f"is not used with output {sensor.output}: it belongs to {owners}"
                )
    if sensor.output != "observations":
        return
    yield from _imaging_problems(key, sensor)
    yield from _mask_problems(key, sensor)


def _imaging_problems(key: str, imaging: StarImaging) -> Iterator[ParameterError]:
    try:
        imaging.camera.camera(f"{key}.camera")
    except ParameterError as problem:
        yield problem
    if not (imaging.camera.width_px and imaging.camera.height_px):
        text = f"and '{key}.camera.height_px' must be given: they define the field of view"
        yield _parameter_error(f"{key}.camera.width_px", text)
    if imaging.direction_given and not imaging.identified:
        yield _parameter_error(f"{key}.direction_given", "needs identified stars: remove one of the two")


def _mask_problems(key: str, sensor: StarSensor) -> Iterator[ParameterError]:
    try:
        masks = sensor_masks(sensor, key)
        if masks is not None and sensor.camera.width_px and sensor.camera.height_px:
            check_field_not_covered(masks, sensor.camera.field_directions(f"{key}.camera"), key)
    except ParameterError as problem:
        yield problem


def _sky_problems(scenario: Scenario) -> Iterator[ParameterError]:
    start_ns = start_time_ns(scenario.start_utc)
    ends_ns = np.array([start_ns, start_ns + round(scenario.duration_s * SECOND_NS)])
    # The margin of one day covers time offsets.
    reason = earth_orientation_table().unavailable_text(ends_ns + np.array([-DAY_NS, DAY_NS]))
    if reason is not None:
        yield _parameter_error("start_utc", f"= {scenario.start_utc}: no sky can be computed: {reason}")


def _theodolite_problems(scenario: Scenario, given: Mapping[str, Any]) -> Iterator[ParameterError]:
    """Yield the errors in the theodolite's part of a scenario; ``given`` is the content of the file."""
    if not scenario.theodolite.aboard:
        for group in ("theodolite", "beacons", "targets", "telescopes"):
            if given.get(group):
                yield _parameter_error(group, "is not used without 'theodolite.aboard: true'")
        return
    programme = scenario.theodolite.programme
    if programme.greatest_elevation_deg < programme.least_elevation_deg:
        yield _parameter_error(
            "theodolite.programme.greatest_elevation_deg",
            f"= {programme.greatest_elevation_deg} deg must not be "
            f"less than least_elevation_deg = {programme.least_elevation_deg} deg",
        )
    for beacon_id, beacon in scenario.beacons.items():
        yield from _beacon_problems(f"beacons.{beacon_id}", beacon, given["beacons"][beacon_id].get("flight", {}))
    if scenario.targets and scenario.theodolite.main_detector.focal_length_m == 0.0:
        yield _parameter_error("theodolite.main_detector.focal_length_m", "must be given where there are targets")
    for target_id, target in scenario.targets.items():
        key, course = f"targets.{target_id}", given["targets"][target_id].get("course", {})
        yield from _course_problems(f"{key}.course", target.course, course)
        yield from _windows_problems(f"{key}.hidden", target.hidden)
    for camera_id, camera in scenario.telescopes.items():
        yield from _imaging_problems(f"telescopes.{camera_id}", camera)
        yield from _windows_problems(f"telescopes.{camera_id}.outages", camera.outages)
    if TELESCOPE_ID in scenario.telescopes:
        text = "is reserved for the telescope for lights: choose another id for a star camera"
        yield _parameter_error(f"telescopes.{TELESCOPE_ID}", text)


def _beacon_problems(key: str, beacon: Beacon, flight: Mapping[str, Any]) -> Iterator[ParameterError]:
    yield from _course_problems(f"{key}.flight", beacon.flight, flight)
    windows = {"hidden": beacon.hidden, "rtk.float_times": beacon.rtk.float_times}
    windows |= {"rtk.no_solution_times": beacon.rtk.no_solution_times, "rtk.outages": beacon.rtk.outages}
    for group, named in windows.items():
        yield from _windows_problems(f"{key}.{group}", named)


def _course_problems(key: str, course: Course, given: Mapping[str, Any]) -> Iterator[ParameterError]:
    used = SECTIONS_OF_COURSE[course.kind]
    for group in SECTIONS_OF_COURSE.values():
        if group in given and group != used:
            yield _parameter_error(f"{key}.{group}", f"is not used by a course of kind {course.kind}: expected {used}")
    moments = [waypoint.time_s for waypoint in course.waypoints.values()]
    if course.kind == "legs" and len(set(moments)) < max(2, len(moments)):
        yield _parameter_error(f"{key}.waypoints", f"must contain two or more with different time_s, got {moments}")


def _windows_problems(key: str, windows: Mapping[str, Outage]) -> Iterator[ParameterError]:
    for name, window in windows.items():
        if window.end_s <= window.start_s:
            text = f"= {window.end_s} s must be after start_s = {window.start_s} s"
            yield _parameter_error(f"{key}.{name}.end_s", text)
