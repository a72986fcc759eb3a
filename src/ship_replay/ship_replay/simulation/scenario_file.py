"""Reads scenario files; what is wrong with one is said with file, line, key and what was expected."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from ship_estimation.parameters import ParameterError, build
from ship_node.errors import BadInput as BadParameterFile
from ship_node.parameter_file import ParameterFile, read_plain
from ship_replay.errors import BadInput
from ship_replay.simulation.faults import can_happen, simulated_topics
from ship_replay.simulation.motion_scenario import SECTIONS_OF_KIND, CarrierMotion
from ship_replay.simulation.scenario import Scenario
from ship_replay.simulation.start_time import start_of


def load_scenario(path: Path | str, recording: Path | None = None) -> Scenario:
    """The checked scenario of a file.

    Args:
        path: YAML file.
        recording: bag to follow instead of the one that the file names.

    Raises:
        BadInput: names file, line, key, value and what was expected.
    """
    try:
        file = read_plain(Path(path))
        scenario = build(Scenario, file.values)
    except BadParameterFile as problem:
        raise BadInput(str(problem)) from problem
    except ParameterError as problem:
        raise BadInput(str(file.error(str(problem)))) from problem
    if recording is not None and scenario.carrier.kind != "recorded":
        raise _error(file, "'carrier.kind' must be recorded to follow a recording")
    scenario = _with_recording(scenario, Path(path).parent, recording)
    for text in _problems(scenario, file):
        raise _error(file, text)
    return scenario


def _error(file: ParameterFile, text: str) -> BadInput:
    return BadInput(str(file.error(text)))


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
            yield from _window_problems(f"star_sensors.{sensor_id}.outages.{name}", outage.start_s, outage.end_s)
    yield from _fault_problems(scenario)


def _carrier_problems(carrier: CarrierMotion, file: ParameterFile) -> Iterator[str]:
    used = SECTIONS_OF_KIND[carrier.kind]
    for group in file.values["carrier"]:
        if group not in ("kind", *used):
            yield f"'carrier.{group}' is not used by a carrier of kind {carrier.kind}: expected {', '.join(used)}"
    if carrier.kind == "recorded" and not Path(carrier.recording.bag).exists():
        named = carrier.recording.bag or "not given"
        yield f"'carrier.recording.bag' = {named} is not there: expected a bag with {carrier.recording.topic}"


def _fault_problems(scenario: Scenario) -> Iterator[str]:
    topics = simulated_topics(scenario)
    for name, fault in scenario.faults.items():
        yield from _window_problems(f"faults.{name}", fault.start_s, fault.end_s)
        if fault.topic not in topics:
            yield f"'faults.{name}.topic' = {fault.topic} is not simulated: expected one of {', '.join(topics)}"
        if not can_happen(fault.kind, topics[fault.topic]):
            yield f"'faults.{name}.kind' = {fault.kind} cannot happen to {topics[fault.topic]}"
        if (fault.kind == "delay") != (fault.delay_s > 0.0):
            yield f"'faults.{name}.delay_s' must be positive with kind delay, and not given with another"


def _window_problems(key: str, start_s: float, end_s: float) -> Iterator[str]:
    if end_s <= start_s:
        yield f"'{key}.end_s' = {end_s} s must be after start_s = {start_s} s"
