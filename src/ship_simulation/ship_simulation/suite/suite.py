"""The configuration of the suite that fits a scenario: same layout, same sigmas."""

import dataclasses
import math
import typing
from typing import Any

import yaml

from ship_attitude_star.ship_attitude.config import InsConfig, ReferenceConfig, StarSensorConfig
from ship_attitude_star.star_attitude.config import ObservingSensorConfig
from ship_attitude_star.stars.star_config import CameraConfig
from ship_bags.parameter_yaml import anywhere
from ship_estimation.ins_config import InsErrorConfig, InsInputConfig
from ship_simulation.messages.ship_messages import DECK_FRAME, INS_FRAME, star_frame
from ship_simulation.messages.theodolite_messages import (
    ANTENNA_FRAME,
    MOUNT_FRAME,
    SHIP_ANTENNA_ID,
    TELESCOPE_FRAME,
    TELESCOPE_ID,
    beacon_frame,
)
from ship_simulation.scenario.scenario import Scenario, StarSensor
from theodolite_calib.config import BeaconConfig, OpticalAxisConfig, ShipConfig

_LEAST_POSITION_TIME_S = 1.0
"""Of the estimator's parameter."""


def suite_configuration(scenario: Scenario) -> dict[str, Any]:
    """Parameters of ``ship_attitude`` as nested mapping."""
    configuration: dict[str, Any] = {"ins": _ins(scenario, InsConfig)}
    if scenario.star_sensors:
        configuration["star_sensors"] = {
            key: {"frame_id": star_frame(key), **_input(sensor), **shared(sensor, StarSensorConfig)}
            for key, sensor in scenario.star_sensors.items()
        }
    if scenario.needs_sky:
        configuration["sky"] = _sky(scenario)
    if scenario.references:
        configuration["references"] = {
            key: {"frame_id": key, **shared(reference, ReferenceConfig)}
            for key, reference in scenario.references.items()
        }
    return configuration


def star_attitude_configuration(scenario: Scenario) -> dict[str, Any]:
    """Parameters of ``star_attitude``, for the sensors that give single stars."""
    return {
        "ins": _ins(scenario, InsInputConfig),
        "star_sensors": {
            key: {
                "frame_id": star_frame(key),
                "camera": shared(sensor.camera, CameraConfig),
                **shared(sensor, ObservingSensorConfig),
            }
            for key, sensor in scenario.star_sensors.items()
            if sensor.output == "observations"
        },
        "sky": _sky(scenario),
    }


def suite_yaml(scenario: Scenario) -> str:
    """The same as ROS 2 parameter file, for whatever namespace, of all nodes that the scenario has inputs for."""
    # Where the fused attitude is in the bag already, ship_attitude has nothing to do.
    nodes = {} if scenario.fused_attitude.written else {"ship_attitude": suite_configuration(scenario)}
    if scenario.theodolite.aboard:
        nodes["optical_axis"] = optical_axis_configuration(scenario)
    if any(sensor.output == "observations" for sensor in scenario.star_sensors.values()):
        nodes["star_attitude"] = star_attitude_configuration(scenario)
    sections = {anywhere(node): {"ros__parameters": values} for node, values in nodes.items()}
    return yaml.safe_dump(sections, sort_keys=False)


def _ins(scenario: Scenario, parameters: type) -> dict[str, Any]:
    return {"frame_id": INS_FRAME, **shared(scenario.ins, parameters)}


def _input(sensor: StarSensor) -> dict[str, Any]:
    """What a sensor sends, and its camera where that is single stars."""
    if sensor.output == "horizon_attitude":
        return {}
    if sensor.output == "inertial_attitude":
        # The simulated tracker sees the air of its boresight alone.
        return {"input": sensor.output, "inertial": {"field_deg": 0.0}}
    return {"input": sensor.output, "camera": shared(sensor.camera, CameraConfig)}


def _sky(scenario: Scenario) -> dict[str, Any]:
    """How well the air and the ship's place are known."""
    weather, position = scenario.weather, scenario.position
    known = {
        "refraction_model": weather.refraction_model,
        "pressure_hpa": weather.pressure_hpa,
        "temperature_c": weather.temperature_c,
        "relative_humidity": 0.01 * weather.humidity_percent,
        "measured_pressure_sigma_hpa": weather.pressure_sigma_hpa,
        "measured_temperature_sigma_k": weather.temperature_sigma_k,
        "magnitude_limit": max(
            sensor.magnitude_limit for sensor in scenario.star_sensors.values() if sensor.output != "horizon_attitude"
        ),
        "fix_sigma_m": math.hypot(position.sigma_m, position.slow_sigma_m),
    }
    if position.slow_sigma_m > 0.0:
        known["position_time_s"] = max(position.slow_time_s, _LEAST_POSITION_TIME_S)
    return known


def optical_axis_configuration(scenario: Scenario) -> dict[str, Any]:
    """Parameters of ``optical_axis`` as nested mapping."""
    configuration = shared_with_groups(scenario.theodolite, OpticalAxisConfig)
    configuration["ship"] = _ship(scenario)
    configuration["ins"] = {"frame_id": INS_FRAME, **shared(scenario.ins, InsErrorConfig)}
    configuration["encoder"]["frame_id"] = MOUNT_FRAME
    configuration["telescope"] |= {"telescope_id": TELESCOPE_ID, "frame_id": TELESCOPE_FRAME}
    for key, beacon in scenario.beacons.items():
        known = shared_with_groups(beacon, BeaconConfig)
        known["rtk"] |= {"frame_id": ANTENNA_FRAME, "base_id": SHIP_ANTENNA_ID, "rover_id": key}
        known["imu"] |= {"frame_id": beacon_frame(key)}
        configuration.setdefault("beacons", {})[key] = known
    return configuration


def _ship(scenario: Scenario) -> dict[str, Any]:
    """Where the ship's attitude comes from: simulated, from the filter, or, without stars, from the INS alone."""
    if scenario.fused_attitude.written:
        fused = scenario.fused_attitude
        return {"frame_id": DECK_FRAME, "slow_time_s": fused.time_s, **shared(fused, ShipConfig)}
    return {"source": "ship/attitude" if scenario.star_sensors else "ins/imu"}


def shared(device: Any, parameters: type) -> dict[str, Any]:
    """The values of a simulated device that the estimator has a parameter of the same name for, without groups."""
    known = {field.name for field in dataclasses.fields(parameters)}
    values = {field.name: getattr(device, field.name) for field in dataclasses.fields(device) if field.name in known}
    return {name: value for name, value in values.items() if not dataclasses.is_dataclass(value)}


def shared_with_groups(device: Any, parameters: type) -> dict[str, Any]:
    """The same, and of all groups that both have."""
    groups = {
        name: shared_with_groups(getattr(device, name), kind)
        for name, kind in typing.get_type_hints(parameters).items()
        if dataclasses.is_dataclass(kind) and hasattr(device, name)
    }
    return shared(device, parameters) | groups
