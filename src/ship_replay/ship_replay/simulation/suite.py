"""The configuration of ``ship_attitude`` that fits a scenario: same layout, same sigmas."""

import dataclasses
from typing import Any

import yaml

from ship_attitude_star.config import InsConfig, ReferenceConfig, StarSensorConfig
from ship_replay.simulation.device_messages import INS_FRAME, star_frame
from ship_replay.simulation.scenario import Scenario


def suite_configuration(scenario: Scenario) -> dict[str, Any]:
    """Parameters of ``ship_attitude`` as nested mapping."""
    configuration: dict[str, Any] = {"ins": {"frame_id": INS_FRAME, **_shared(scenario.ins, InsConfig)}}
    if scenario.star_sensors:
        configuration["star_sensors"] = {
            key: {"frame_id": star_frame(key), **_shared(sensor, StarSensorConfig)}
            for key, sensor in scenario.star_sensors.items()
        }
    if scenario.references:
        configuration["references"] = {
            key: {"frame_id": key, **_shared(reference, ReferenceConfig)}
            for key, reference in scenario.references.items()
        }
    return configuration


def suite_yaml(scenario: Scenario) -> str:
    """The same as ROS 2 parameter file."""
    return yaml.safe_dump({"ship_attitude": {"ros__parameters": suite_configuration(scenario)}}, sort_keys=False)


def _shared(device: Any, parameters: type) -> dict[str, Any]:
    """The values of a simulated device that the estimator has a parameter of the same name for, without groups."""
    known = {field.name for field in dataclasses.fields(parameters)}
    values = {field.name: getattr(device, field.name) for field in dataclasses.fields(device) if field.name in known}
    return {name: value for name, value in values.items() if not dataclasses.is_dataclass(value)}
