"""The suite file of a scenario, which gives the sigmas of the scenario to the estimators.

The devices of a scenario and of a node have common schemas, whose parameters a node receives. The module imports no
configuration of a node; a test loads the file of each scenario into the configurations of the nodes.
"""

import math
from dataclasses import asdict, fields
from typing import Any

import yaml

from ship_bags.parameter_yaml import PARAMETERS_KEY, in_any_namespace
from ship_estimation.parameters.ship_devices import (
    SCHULER,
    BaselineSurvey,
    ReferenceErrors,
    StarSensorErrors,
    StarSensorMounting,
)
from ship_estimation.parameters.theodolite_devices import (
    AxesConfig,
    BaselineErrors,
    DroneAttitudeErrors,
    MainAxisInCamera,
    MainDetectorOptics,
    TelescopeOptics,
)
from ship_simulation.scenario.names import (
    ANTENNA_FRAME,
    DECK_FRAME,
    INS_FRAME,
    MAIN_DETECTOR_FRAME,
    MOUNT_FRAME,
    SECOND_ANTENNA_ID,
    SHIP_ANTENNA_ID,
    TELESCOPE_FRAME,
    TELESCOPE_ID,
    beacon_frame,
    mount_camera_frame,
    star_frame,
)
from ship_simulation.scenario.scenario import Scenario, StarSensor
from ship_simulation.scenario.theodolite_scenario import Beacon, ShipBaseline
from ship_simulation.ship.ship_track import deflection_table
from ship_stars.camera.config import CameraConfig

_INS = (
    "tilt_sigma_arcsec",
    "tilt_time_s",
    "heading_sigma_arcsec",
    "heading_time_s",
    "white_sigma_arcsec",
    "time_offset_s",
    "time_offset_sigma_s",
)
_INS_FOR_STAR_ATTITUDE = tuple(name for name in _INS if name not in ("tilt_time_s", "heading_time_s"))
"""Parameters of the INS for ``star_attitude``, which has no parameters for the correlation times."""

_MIN_POSITION_TIME_S = 1.0
"""Minimum of the estimator's parameter ``position_time_s``."""


def suite_yaml(scenario: Scenario) -> str:
    """Return a ROS 2 parameter file, for any namespace, of all nodes for which the scenario has inputs."""
    # A bag that contains the fused attitude needs no ship_attitude.
    nodes = {} if scenario.fused_attitude.written else {"ship_attitude": suite_configuration(scenario)}
    if scenario.theodolite.aboard:
        nodes["optical_axis"] = optical_axis_configuration(scenario)
    if any(sensor.output == "observations" for sensor in scenario.star_sensors.values()):
        nodes["star_attitude"] = star_attitude_configuration(scenario)
    sections = {in_any_namespace(node): {PARAMETERS_KEY: values} for node, values in nodes.items()}
    return yaml.safe_dump(sections, sort_keys=False)


def suite_configuration(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters of ``ship_attitude`` as nested mapping."""
    configuration: dict[str, Any] = {"ins": _ins(scenario, _INS)}
    if scenario.ins.model == SCHULER:
        configuration["ins"] |= {"model": SCHULER, "schuler": asdict(scenario.ins.schuler)}
    if scenario.gravity.told != "none":
        configuration["gravity"] = _gravity(scenario)
    elif scenario.ins.model == SCHULER and scenario.gravity.is_level:
        configuration["gravity"] = {"unknown_sigma_arcsec": 0.0}
    if scenario.star_sensors:
        configuration["star_sensors"] = {
            key: {
                "frame_id": star_frame(key),
                **_input(sensor),
                **_of_schema(sensor, StarSensorMounting),
                **_of_schema(sensor, StarSensorErrors),
                **_masks(sensor),
            }
            for key, sensor in scenario.star_sensors.items()
        }
    if scenario.needs_sky:
        configuration["sky"] = _sky_of_ship(scenario)
    if scenario.references:
        configuration["references"] = {
            key: {"frame_id": key, **_of_schema(reference, ReferenceErrors)}
            for key, reference in scenario.references.items()
        }
    if scenario.ship_baseline.is_aboard:
        configuration["ship_baseline"] = _ship_baseline(scenario.ship_baseline)
    return configuration


def _ship_baseline(baseline: ShipBaseline) -> dict[str, Any]:
    ids = {"frame_id": ANTENNA_FRAME, "base_id": SHIP_ANTENNA_ID, "rover_id": SECOND_ANTENNA_ID}
    rtk = {
        "noise_sigma_m": baseline.rtk.sigma_m,
        "bias_sigma_m": baseline.rtk.bias_sigma_m,
        "bias_time_s": baseline.rtk.bias_time_s,
    }
    return {**ids, **_of_schema(baseline, BaselineSurvey), **rtk}


def _gravity(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters of the deflection of the vertical."""
    gravity = scenario.gravity
    parameters: dict[str, Any] = {
        "deflection": gravity.told,
        "sigma_arcsec": gravity.sigma_arcsec,
        "unknown_sigma_arcsec": gravity.told_unknown_sigma_arcsec,
        "correlation_length_m": gravity.correlation_length_m,
    }
    if gravity.told == "constant":
        return parameters | _select_parameters(gravity, ("xi_arcsec", "eta_arcsec"))
    return parameters | deflection_table(scenario) if gravity.told == "table" else parameters


def star_attitude_configuration(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters of ``star_attitude``, for the sensors that give single stars."""
    return {
        "ins": _ins(scenario, _INS_FOR_STAR_ATTITUDE),
        "star_sensors": {
            key: {
                "frame_id": star_frame(key),
                "camera": _of_schema(sensor.camera, CameraConfig),
                **_of_schema(sensor, StarSensorMounting),
                **_masks(sensor),
            }
            for key, sensor in scenario.star_sensors.items()
            if sensor.output == "observations"
        },
        "sky": _sky_of_ship(scenario),
    }


def optical_axis_configuration(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters of ``optical_axis`` as nested mapping."""
    theodolite = scenario.theodolite
    configuration = {
        "encoder": {"sigma_arcsec": theodolite.encoder.sigma_arcsec, "frame_id": MOUNT_FRAME},
        "axes": _of_schema(theodolite.axes, AxesConfig),
        "deformation": asdict(theodolite.deformation),
        "lever": asdict(theodolite.lever),
        "telescope": {
            **_of_schema(theodolite.telescope, TelescopeOptics),
            "telescope_id": TELESCOPE_ID,
            "frame_id": TELESCOPE_FRAME,
        },
        "air": asdict(theodolite.air),
        "ship_antenna": asdict(theodolite.ship_antenna),
        "ship": _ship(scenario),
        "ins": _ins(scenario, _INS),
    }
    if scenario.targets:
        optics = _of_schema(theodolite.main_detector, MainDetectorOptics)
        configuration["main_detector"] = {**optics, "frame_id": MAIN_DETECTOR_FRAME}
    if scenario.telescopes:
        configuration["telescopes"] = {
            key: {
                **_of_schema(camera, MainAxisInCamera),
                "frame_id": mount_camera_frame(key),
                "camera": _of_schema(camera.camera, CameraConfig),
            }
            for key, camera in scenario.telescopes.items()
        }
        configuration["sky"] = _sky(scenario, [camera.magnitude_limit for camera in scenario.telescopes.values()])
    if scenario.beacons:
        configuration["beacons"] = {key: _beacon(key, beacon) for key, beacon in scenario.beacons.items()}
    return configuration


def _ins(scenario: Scenario, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the named parameters of the INS, and those of its rates that are not zero."""
    rates = _select_parameters(scenario.ins, ("rate_sigma_arcsec_per_s", "rate_has_earth_rate"))
    known_rates = {name: value for name, value in rates.items() if value}
    return {"frame_id": INS_FRAME, **_select_parameters(scenario.ins, names), **known_rates}


def _select_parameters(device: object, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(device, name) for name in names}


def _of_schema(device: Any, schema: type) -> dict[str, Any]:
    """Return the parameters of a device that belong to a schema of it."""
    return {name: value for name, value in asdict(device).items() if name in {field.name for field in fields(schema)}}


def _input(sensor: StarSensor) -> dict[str, Any]:
    """Return the input type of a sensor, and its camera if it sends single stars; empty for horizon attitudes."""
    if sensor.output == "horizon_attitude":
        return {}
    if sensor.output == "inertial_attitude":
        # The simulated tracker is affected by the refraction at its boresight only.
        return {"input": sensor.output, "inertial": {"field_deg": 0.0}}
    return {"input": sensor.output, "camera": _of_schema(sensor.camera, CameraConfig)}


def _masks(sensor: StarSensor) -> dict[str, Any]:
    """Return the masks of a sensor; empty if there are none."""
    masks = {
        name: {"azimuths_deg": list(mask.azimuths_deg), "elevations_deg": list(mask.elevations_deg)}
        for name, mask in sensor.masks.items()
    }
    return {"masks": masks} if masks else {}


def _sky_of_ship(scenario: Scenario) -> dict[str, Any]:
    looking = [sensor for sensor in scenario.star_sensors.values() if sensor.output != "horizon_attitude"]
    return _sky(scenario, [sensor.magnitude_limit for sensor in looking])


def _sky(scenario: Scenario, magnitude_limits: list[float]) -> dict[str, Any]:
    """Return the parameters of air, position errors and the faintest star of all cameras."""
    weather, position = scenario.weather, scenario.position
    known = {
        "refraction_model": weather.refraction_model,
        "pressure_hpa": weather.pressure_hpa,
        "temperature_c": weather.temperature_c,
        "relative_humidity": 0.01 * weather.humidity_percent,
        "measured_pressure_sigma_hpa": weather.pressure_sigma_hpa,
        "measured_temperature_sigma_k": weather.temperature_sigma_k,
        "magnitude_limit": max(magnitude_limits),
        "fix_sigma_m": math.hypot(position.sigma_m, position.slow_sigma_m),
    }
    if position.slow_sigma_m > 0.0:
        known["position_time_s"] = max(position.slow_time_s, _MIN_POSITION_TIME_S)
    return known


def _ship(scenario: Scenario) -> dict[str, Any]:
    """Return the parameters of the ship's attitude: its source, or the errors of a simulated ``ship/attitude``."""
    if scenario.fused_attitude.written:
        fused = scenario.fused_attitude
        sigmas = {"slow_time_s": fused.time_s, "white_sigma_arcsec": fused.white_sigma_arcsec}
        return {"frame_id": DECK_FRAME, **sigmas}
    return {"source": "ship/attitude" if scenario.star_sensors else "ins/imu"}


def _beacon(beacon_id: str, beacon: Beacon) -> dict[str, Any]:
    ids = {"frame_id": ANTENNA_FRAME, "base_id": SHIP_ANTENNA_ID, "rover_id": beacon_id}
    return {
        "light": asdict(beacon.light),
        "rtk": {**_of_schema(beacon.rtk, BaselineErrors), **ids},
        "imu": {**_of_schema(beacon.imu, DroneAttitudeErrors), "frame_id": beacon_frame(beacon_id)},
    }
