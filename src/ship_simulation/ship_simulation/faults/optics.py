"""Cameras of devices from a suite file, with which faults rotate devices or add false spots."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import merge_sections, read_sections
from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.mount.image import Camera
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import IMAGE, IMAGE_TOPIC, OBSERVATIONS, mount_stars_topic
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.config import CameraConfig

_TURNS = ("knock", "drift")
_SPOTS = ("false_stars", "false_lights")


@dataclass(frozen=True)
class Optics:
    """Cameras of the devices.

    Attributes:
        stars: topic of stars → camera that observes them.
        telescope: camera of the calibration telescope; None if there is no such telescope.
    """

    stars: Mapping[str, StarCamera] = field(default_factory=dict)
    telescope: Camera | None = None

    def missing_camera_reason(self, fault: Fault, type_name: str) -> str:
        """Return a text on a camera that a fault needs but the suite file does not describe; else an empty text."""
        if fault.kind not in (*_TURNS, *_SPOTS):
            return ""
        if type_name == OBSERVATIONS and fault.topic not in self.stars:
            return f"no star sensor or telescope of the suite file has a camera for {fault.topic}"
        if type_name == IMAGE and self.telescope is None:
            return f"the suite file does not describe the telescope of {IMAGE_TOPIC}"
        return ""


def optics_of_suite(text: str) -> Optics:
    """Return the cameras that a suite file describes.

    Raises:
        BadInput: the text is not a parameter file, or a camera in it is invalid.
    """
    stars: dict[str, StarCamera] = {}
    telescope = None
    name, sections = read_sections(text)
    for section in sections:
        values = merge_sections(name, [section]).values
        for group, topic_of in _WITH_STARS.items():
            for id_, sensor in values.get(group, {}).items():
                if isinstance(sensor, dict) and sensor.get("camera"):
                    stars[topic_of(id_)] = _star_camera(f"{group}.{id_}.camera", sensor["camera"])
        if isinstance(values.get("telescope"), dict) and "focal_length_m" in values["telescope"]:
            telescope = telescope_camera(**{key: values["telescope"].get(key, 0.0) for key in _TELESCOPE})
    return Optics(stars, telescope)


_WITH_STARS = {"star_sensors": "star/{}/observations".format, "telescopes": mount_stars_topic}
"""Parameter group of devices that give single stars → function from the id of a device to the topic of its stars."""

_TELESCOPE = ("focal_length_m", "principal_x_m", "principal_z_m")


def telescope_camera(focal_length_m: float, principal_x_m: float, principal_z_m: float) -> Camera:
    """Return the camera of the calibration telescope."""
    return Camera(focal_length_m, 0.0, np.array([principal_x_m, principal_z_m]))


def _star_camera(prefix: str, values: Mapping[str, Any]) -> StarCamera:
    try:
        return build(CameraConfig, values, f"{prefix}.").camera(prefix)
    except ParameterError as problem:
        raise BadInput(f"suite file: {problem}", parameters=problem.parameters, value=problem.value) from problem
