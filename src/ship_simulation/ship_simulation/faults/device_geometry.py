"""Geometry of devices in faults: cameras from a suite file, and rotations of attitudes, rates and image points.

A rotation is given by a rotation vector ``turn``, rad. A rotation in the frame of the device (forward, up, right) is a
mounting shift, R' = R exp(turn). Fixed stars and lights then appear in directions rotated by exp(-turn). A rotation in
the horizon frame (North, Up, East) is an attitude error, R' = exp(turn) R.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ship_bags.errors import BadInput
from ship_bags.parameter_yaml import merge_sections, read_sections
from ship_estimation.parameters.schema import ParameterError, build
from ship_geometry.frames import (
    FLU_FROM_DEVICE,
    FRD_FROM_DEVICE,
    NED_FROM_HORIZON,
    angles_from_rotation,
    celestial_rotation_from_quaternion,
    device_vector_from_ros,
    flu_from_device_vector,
    quaternion_from_rotation,
    rotation_from_angles,
    rotation_from_quaternion,
)
from ship_geometry.mount.image import Camera
from ship_geometry.rotations import FloatArray, exp_rotation
from ship_simulation.scenario.fault import Fault
from ship_simulation.scenario.names import (
    IMAGE,
    IMAGE_TOPIC,
    IMU,
    INERTIAL,
    OBSERVATIONS,
    SHIP_ATTITUDE,
    STAR,
    mount_stars_topic,
)
from ship_stars.camera.camera import StarCamera
from ship_stars.camera.config import CameraConfig

_NEEDS_CAMERA = ("knock", "drift", "false_stars", "false_lights")
"""Kinds of faults that change stars or lights by means of their camera."""

_WITH_STARS = {"star_sensors": "star/{}/observations".format, "telescopes": mount_stars_topic}
"""Parameter group of devices that give single stars → function from the id of a device to the topic of its stars."""

_TELESCOPE = ("focal_length_m", "principal_x_m", "principal_z_m")
_ANGLES = {STAR: ("azimuth", "elevation", "roll"), SHIP_ATTITUDE: ("heading", "pitch", "roll")}
_FRD_FROM_FLU = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class SuiteOptics:
    """Cameras of the devices.

    Attributes:
        stars: topic of stars → camera that observes them.
        telescope: camera of the calibration telescope; None if there is no such telescope.
    """

    stars: Mapping[str, StarCamera] = field(default_factory=dict)
    telescope: Camera | None = None

    def missing_camera_reason(self, fault: Fault, type_name: str) -> str:
        """Return a text on a camera that a fault needs but the suite file does not describe; else an empty text."""
        if fault.kind not in _NEEDS_CAMERA:
            return ""
        if type_name == OBSERVATIONS and fault.topic not in self.stars:
            return f"no star sensor or telescope of the suite file has a camera for {fault.topic}"
        if type_name == IMAGE and self.telescope is None:
            return f"the suite file does not describe the telescope of {IMAGE_TOPIC}"
        return ""


def optics_of_suite(text: str) -> SuiteOptics:
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
            focal_length_m, *principal_m = (values["telescope"].get(key, 0.0) for key in _TELESCOPE)
            telescope = Camera(focal_length_m, 0.0, np.array(principal_m))
    return SuiteOptics(stars, telescope)


def _star_camera(prefix: str, values: Mapping[str, Any]) -> StarCamera:
    try:
        return build(CameraConfig, values, f"{prefix}.").camera(prefix)
    except ParameterError as problem:
        raise BadInput(f"suite file: {problem}", parameters=problem.parameters, value=problem.value) from problem


def turn_in_device(message: Any, type_name: str, turn: FloatArray, topic: str, optics: SuiteOptics) -> None:
    """Rotate a device in its own frame; the angular rates are then in the rotated axes."""
    back = exp_rotation(-turn)
    if type_name == OBSERVATIONS:
        camera = optics.stars[topic]
        _move(message.stars, ("u", "v"), lambda points: camera.pixels(camera.directions(points) @ back.T))
    elif type_name == IMAGE and optics.telescope is not None:
        telescope = optics.telescope
        _move(message.beacons, ("x", "z"), lambda points: telescope.points(telescope.directions(points) @ back.T))
    elif type_name == INERTIAL:
        rotation_cs = celestial_rotation_from_quaternion(np.array(_xyzw(message.orientation)))
        _set_xyzw(message, _quaternion(rotation_cs @ back.T @ FLU_FROM_DEVICE.T))
    else:
        _set_attitude(message, type_name, _attitude(message, type_name) @ back.T)
        if type_name != STAR:
            rate_d = device_vector_from_ros(np.array(_xyz(message.angular_velocity)))
            _set_xyz(message.angular_velocity, flu_from_device_vector(back @ rate_d))


def turn_in_horizon(message: Any, type_name: str, turn: FloatArray) -> None:
    """Rotate an attitude about the horizon's axes."""
    _set_attitude(message, type_name, exp_rotation(turn) @ _attitude(message, type_name))


def convert_axes(message: Any, type_name: str, axes: str) -> None:
    """Convert an attitude or a baseline to the wrong axes of a faulty driver."""
    ned = axes == "ned_frd"
    if not hasattr(message, "orientation"):
        x, y, z = _xyz(message.enu)
        _set_xyz(message.enu, [y, x, -z if ned else z])
        return
    quaternion = np.array(_xyzw(message.orientation))
    if not ned:
        x, y, z, w = quaternion.tolist()
        _set_xyzw(message, [y, x, z, w])
    elif type_name == INERTIAL:
        _set_xyzw(message, _quaternion(celestial_rotation_from_quaternion(quaternion) @ FRD_FROM_DEVICE.T))
    else:
        rotation_nd = rotation_from_quaternion(quaternion)
        _set_xyzw(message, _quaternion(NED_FROM_HORIZON @ rotation_nd @ FRD_FROM_DEVICE.T))
    if type_name in (IMU, SHIP_ATTITUDE):
        x, y, z = _xyz(message.angular_velocity)
        _set_xyz(message.angular_velocity, _FRD_FROM_FLU @ [x, y, z] if ned else [y, x, z])


def _attitude(message: Any, type_name: str) -> FloatArray:
    """Return the rotation "horizon from device" of a message."""
    if type_name == STAR:
        return rotation_from_angles(message.azimuth, message.elevation, message.roll)
    return rotation_from_quaternion(np.array(_xyzw(message.orientation)))


def _set_attitude(message: Any, type_name: str, rotation: FloatArray) -> None:
    angles = angles_from_rotation(rotation).tolist()
    for name, angle in zip(_ANGLES.get(type_name, ()), angles, strict=False):
        setattr(message, name, angle)
    if type_name != STAR:
        _set_xyzw(message, quaternion_from_rotation(rotation).tolist())


def _move(spots: Any, names: tuple[str, str], moved: Callable[[FloatArray], FloatArray]) -> None:
    if not spots:
        return
    first, second = names
    points = moved(np.array([[getattr(spot, first), getattr(spot, second)] for spot in spots]))
    for spot, (x, y) in zip(spots, points.tolist(), strict=True):
        setattr(spot, first, x)
        setattr(spot, second, y)


def _quaternion(matrix: FloatArray) -> list[float]:
    """Return x, y, z, w of a rotation matrix between ROS's own axes."""
    found: list[float] = Rotation.from_matrix(matrix).as_quat(canonical=True).tolist()
    return found


def _xyzw(quaternion: Any) -> list[float]:
    return [quaternion.x, quaternion.y, quaternion.z, quaternion.w]


def _set_xyzw(message: Any, xyzw: list[float]) -> None:
    q = message.orientation
    q.x, q.y, q.z, q.w = xyzw


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def _set_xyz(vector: Any, xyz: Any) -> None:
    vector.x, vector.y, vector.z = (float(value) for value in xyz)
