"""Contradictions between a suite configuration and a bag: installations, cameras, focal lengths."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ship_attitude_star.ship_attitude.config import ReferenceConfig, ShipAttitudeConfig
from ship_attitude_star.star_attitude.config import StarAttitudeConfig
from ship_bags.errors import BadInput
from ship_bags.mcap.bag_reader import Bag
from ship_bags.stamps import NS_PER_S, ns_from_stamp
from ship_geometry.frames import angles_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray, angle_between, log_rotation
from ship_replay.preflight.check_camera import (
    CameraTurn,
    camera_contradictions,
    cameras_counting_from_one,
    rate_corrected_turn,
)
from ship_replay.preflight.check_config import BagCheck
from ship_replay.preflight.measured_camera import EXPECTED_AXES
from ship_replay.preflight.measured_mounting import MeasuredMounting, measured_mountings
from theodolite_calib.config import OpticalAxisConfig

_SIGMAS = 5.0
_LARGE_ERROR = np.deg2rad(1.0)
"""Installation error above which no star would be used, whatever the sigma, rad."""

_MIN_REPORTED_ANGLE = np.deg2rad(0.01)
_MIN_ATTITUDES = 3
_LOOKS_LIKE_RADIANS_DEG = 1.0

_IMAGES = 30
_NEAR_NS = NS_PER_S // 5
_MIN_PAIRS = 5
_MIN_ANGLE = np.deg2rad(0.1)
_TOLERANCE = 0.2
"""Relative tolerance of the focal length. Baselines start at the ship's antenna instead of the telescope, which changes
angles by a few percent at some hundred metres."""

_IMAGE_TOPIC = "theodolite/beacons"


@dataclass(frozen=True)
class _InstallationResidual:
    """Difference between measured and configured installation.

    Attributes:
        mounting: measured mounting.
        measured_dv: measured rotation deck from device, shape (3, 3).
        turn_d: rotation vector, deck frame, from the configured to the measured installation, rad, shape (3,).
        is_inlier: True for the compared times that are not outliers, shape (n,).
        sigmas: largest ratio of a component of the rotation vector, in the device frame, to its sigma.
    """

    mounting: MeasuredMounting
    measured_dv: FloatArray
    turn_d: FloatArray
    is_inlier: NDArray[np.bool_]
    sigmas: float


def check_installation(check: BagCheck) -> None:
    """Compare configured installations and cameras with those measured in the bag.

    The attitudes of each device are compared with the INS at some times of the bag, and the stars of each camera with
    one another.
    """
    reported = {*check.findings.errors, *check.findings.warnings}
    for node in check.nodes:
        if not isinstance(node.config, (ShipAttitudeConfig, StarAttitudeConfig, OpticalAxisConfig)):
            continue
        mountings = list(measured_mountings(node.config, check.bag, check.usable))
        for is_error, parameter, text in _contradictions(mountings, node.config, check.bag):
            line = f"{node.place(check.path, parameter)}: {text}"
            # Replaced values are already reported.
            if line not in reported and parameter not in node.replaced_parameters:
                reported.add(line)
                check.report(is_error, line)


def _contradictions(
    mountings: Sequence[MeasuredMounting], config: Any, bag: Bag
) -> Iterator[tuple[bool, str, str]]:
    """Yield each contradiction as True (error) or False (warning), parameter, and text."""
    residuals = []
    for mounting in mountings:
        yield from camera_contradictions(mounting, bag)
        if len(mounting.rotations_dv) >= _MIN_ATTITUDES:
            residuals.append(_residual(mounting, config))
    far = [residual for residual in residuals if np.linalg.norm(residual.turn_d) > _LARGE_ERROR]
    common = _common_rotation(far) if len(far) == len(residuals) else None
    if common is not None:
        yield True, "ins", _ins_rotation_text(common, far, bag)
        return
    for residual in residuals:
        yield from _installation(residual, bag)
    yield from _pixel_count(residuals, config, bag)


def _residual(mounting: MeasuredMounting, config: Any) -> _InstallationResidual:
    rotations_dv = mounting.rotations_dv
    # Exclude outliers: misidentified stars, and times of a wrong clock.
    middle = _mean(rotations_dv)
    distances = np.linalg.norm(log_rotation(middle.T @ rotations_dv), axis=-1)
    kept = distances <= 3.0 * np.median(distances) + ARCSEC
    middle = _mean(rotations_dv[kept])
    scatter_v = log_rotation(middle.T @ rotations_dv[kept]).std(axis=0)
    configured_dv, installation_sigma_v = _configured_installation(mounting.device)
    ins = config.ins
    ins_sigma = ARCSEC * np.hypot(max(ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec), ins.white_sigma_arcsec)
    sigma_v = np.sqrt(installation_sigma_v**2 + ins_sigma**2 + scatter_v**2)
    turn_v = log_rotation(configured_dv.T @ middle)
    # All sigmas may be 0: then any rotation is a contradiction.
    sigmas = float(np.max(np.abs(turn_v) / np.maximum(sigma_v, 0.1 * ARCSEC)))
    return _InstallationResidual(mounting, middle, log_rotation(middle @ configured_dv.T), kept, sigmas)


def _mean(rotations: FloatArray) -> FloatArray:
    """Return the mean of rotations of shape (n, 3, 3): the rotation nearest to all of them, shape (3, 3)."""
    left, _, right = np.linalg.svd(rotations.sum(axis=0))
    sign = np.linalg.det(left @ right)
    mean: FloatArray = left @ np.diag([1.0, 1.0, sign]) @ right
    return mean


def _configured_installation(device: Any) -> tuple[FloatArray, FloatArray]:
    """Return the configured rotation deck from device, and its sigma about the device's axes, rad."""
    if isinstance(device, ReferenceConfig):
        return device.rotation_dr, device.installation_sigma_r
    return device.rotation_ds, device.installation_sigma_s


def _common_rotation(far: Sequence[_InstallationResidual]) -> FloatArray | None:
    """Return the rotation vector common to all devices, rad, shape (3,).

    The result is None if the rotations differ, or if there are fewer than two devices.
    """
    if len(far) < 2:
        return None
    turns = np.array([residual.turn_d for residual in far])
    are_equal = np.linalg.norm(turns - turns.mean(axis=0), axis=-1) < _LARGE_ERROR
    return turns.mean(axis=0) if np.all(are_equal) else None


def _ins_rotation_text(turn_d: FloatArray, far: Sequence[_InstallationResidual], bag: Bag) -> str:
    # A right-handed rotation about up is to port; headings count the opposite way.
    forward, up, right = np.rad2deg(turn_d)
    topics = ", ".join(f"'{residual.mounting.topic}'" for residual in far)
    return (
        f"all of {topics} in {bag.path} have the same rotation against 'ins/imu': {forward:.1f} deg about the deck's "
        f"forward axis, {up:.1f} about up, {right:.1f} about right: check 'ins.convention' and "
        "'ins.installation_heading_deg', '..._pitch_deg', '..._roll_deg'"
    )


def _installation(residual: _InstallationResidual, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    angle = float(np.linalg.norm(residual.turn_d))
    if not (residual.sigmas > _SIGMAS and angle > _MIN_REPORTED_ANGLE):
        return
    mounting = residual.mounting
    where = f"'{mounting.topic}' and 'ins/imu' in {bag.path}"
    if angle <= _LARGE_ERROR:
        text = (
            f"{mounting.section}: by {where} the installation is {np.rad2deg(angle):.3f} deg off, "
            f"{residual.sigmas:.0f} of its sigmas: run calibrate_installation"
        )
        yield False, mounting.section, text
        return
    names = ("heading_deg", "pitch_deg", "roll_deg")
    if not isinstance(mounting.device, ReferenceConfig):
        names = ("azimuth_deg", "elevation_deg", "roll_deg")
    measured_deg = np.rad2deg(angles_from_rotation(residual.measured_dv))
    for name, measured in zip(names, measured_deg, strict=True):
        configured = getattr(mounting.device, name)
        if abs(_wrap_deg(configured - measured)) > np.rad2deg(_LARGE_ERROR):
            in_radians = abs(_wrap_deg(np.rad2deg(configured) - measured)) < _LOOKS_LIKE_RADIANS_DEG
            hint = ": radians for degrees?" if in_radians else ""
            parameter = f"{mounting.section}.{name}"
            text = f"parameter '{parameter}' = {configured:g} deg, but {where} give {measured:.2f} deg{hint}"
            yield True, parameter, text


def _pixel_count(residuals: Sequence[_InstallationResidual], config: Any, bag: Bag) -> Iterator[tuple[bool, str, str]]:
    """Yield a warning for each camera whose pixels seem to be counted from 1."""
    ins = config.ins
    # A mirrored image is reported by itself.
    cameras = [one for one in residuals if (camera := one.mounting.camera) and camera.axes is EXPECTED_AXES]
    ins_sigma_d = ARCSEC * np.array([ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec, ins.tilt_sigma_arcsec])
    for number in cameras_counting_from_one([_camera_turn(residual) for residual in cameras], np.diag(ins_sigma_d**2)):
        mounting = cameras[number].mounting
        name = f"{mounting.section}.camera.principal_u_px"
        text = (
            f"parameter '{name}': by '{mounting.topic}', other cameras and 'ins/imu' in {bag.path} the stars are one "
            "pixel to the right and down: if pixels are counted from 1, subtract 1 from u and v"
        )
        yield False, name, text


def _camera_turn(residual: _InstallationResidual) -> CameraTurn:
    mounting, kept = residual.mounting, residual.is_inlier
    device, camera = mounting.device, mounting.device.camera
    turns_d = log_rotation(mounting.rotations_dv[kept] @ device.rotation_ds.T)
    turn_d, noise_d = rate_corrected_turn(turns_d, mounting.rates_d[kept])
    installation_d = device.rotation_ds * device.installation_sigma_s
    flexure = ARCSEC * getattr(device, "flexure_sigma_arcsec", 0.0)
    pixel = camera.pixel_pitch_m / camera.focal_length_m
    return CameraTurn(
        turn_d=turn_d,
        covariance_d=noise_d + installation_d @ installation_d.T + flexure**2 * np.eye(3),
        pixel_d=device.rotation_ds @ np.array([0.0, pixel, pixel]),
    )


def _wrap_deg(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


def check_telescope(check: BagCheck) -> None:
    """Compare the configured focal length with the ratio of image distances to angles between the lights."""
    for node in check.nodes:
        if isinstance(node.config, OpticalAxisConfig) and _IMAGE_TOPIC in check.usable:
            measured_m = _focal_length_m(node.config, check.bag, check.usable)
            configured_m = node.config.telescope.focal_length_m
            if measured_m is not None and not abs(measured_m / configured_m - 1.0) <= _TOLERANCE:
                name = "telescope.focal_length_m"
                check.findings.errors.append(
                    f"{node.place(check.path, name)}: parameter '{name}' = {configured_m:g} m, but lights on "
                    f"'{_IMAGE_TOPIC}' in {check.bag.path} have distances that fit {measured_m:.2g} m"
                )


def _focal_length_m(config: OpticalAxisConfig, bag: Bag, usable: dict[str, str]) -> float | None:
    """Return the median focal length over pairs of lights, m; None if there are too few pairs."""
    images, baselines = _collect_images(config, bag, usable)
    ratios_m: list[float] = []
    for time_ns, points_m in images:
        lines = {
            id_: line for id_ in points_m if (line := _nearest_direction(baselines.get(id_, []), time_ns)) is not None
        }
        for one, other in combinations(sorted(lines), 2):
            angle = float(angle_between(lines[one], lines[other]))
            distance_m = float(np.linalg.norm(points_m[one] - points_m[other]))
            if angle > _MIN_ANGLE and distance_m > 0.0:
                ratios_m.append(distance_m / angle)
    return float(np.median(ratios_m)) if len(ratios_m) >= _MIN_PAIRS else None


def _collect_images(
    config: OpticalAxisConfig, bag: Bag, usable: dict[str, str]
) -> tuple[list[tuple[int, dict[str, FloatArray]]], dict[str, list[tuple[int, FloatArray]]]]:
    """Return images with several lights, spread over the bag, and the unit vectors to the beacons by time."""
    topics = {f"beacon/{id_}/baseline": id_ for id_ in config.beacons if f"beacon/{id_}/baseline" in usable}
    relative = {usable[topic]: topic for topic in (*topics, _IMAGE_TOPIC)}
    spacing_ns = (bag.end_ns - bag.start_ns) // _IMAGES
    images: list[tuple[int, dict[str, FloatArray]]] = []
    baselines: dict[str, list[tuple[int, FloatArray]]] = {id_: [] for id_ in topics.values()}
    for record in bag.records(relative):
        try:
            message: Any = record.decode()
        except BadInput:
            continue
        time_ns = ns_from_stamp(message.header.stamp)
        if relative[record.topic] == _IMAGE_TOPIC:
            points_m = {light.beacon_id: np.array([light.x, light.z]) for light in message.beacons}
            if len(points_m) > 1 and (not images or time_ns - images[-1][0] >= spacing_ns):
                images.append((time_ns, points_m))
        else:
            vector_m = np.array([message.enu.x, message.enu.y, message.enu.z])
            distance_m = float(np.linalg.norm(vector_m))
            if distance_m > 0.0:
                baselines[topics[relative[record.topic]]].append((time_ns, vector_m / distance_m))
    return images, baselines


def _nearest_direction(baselines: list[tuple[int, FloatArray]], time_ns: int) -> FloatArray | None:
    """Return the unit vector nearest in time; None if none is within ``_NEAR_NS``."""
    index = bisect_left(baselines, time_ns, key=lambda entry: entry[0])
    near = [entry for entry in baselines[max(index - 1, 0) : index + 1] if abs(entry[0] - time_ns) <= _NEAR_NS]
    return min(near, key=lambda entry: abs(entry[0] - time_ns))[1] if near else None
