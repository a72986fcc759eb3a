"""Camera and mounting parameters of a star sensor, and the filter states of the camera's correlated errors.

``ship_attitude`` and ``star_attitude`` share the parameters. The correlated errors are those of the optics and the
field-spatial errors (:mod:`ship_stars.camera.errors`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ship_estimation.kalman.kalman_filter import StateBlock, block
from ship_estimation.parameters.fields import mapping_of, parameter
from ship_estimation.parameters.schema import ParameterError
from ship_estimation.parameters.ship_devices import StarSensorMounting
from ship_geometry.rotations import FloatArray
from ship_stars.camera.camera import Distortion, StarCamera
from ship_stars.camera.errors import (
    FIELD_MODES,
    OPTICS_MODES,
    SOURCE_FIELD,
    SOURCE_OPTICS,
    SURVEYED_FOCAL_SIGMA,
    OpticsErrors,
    SpatialErrors,
)
from ship_stars.sky.deck_masks import MaskConfig, MountedSensor, SensorMasks, check_field_not_covered, sensor_masks

JOINT = "joint"
"""Id of the joint solution, one attitude of the deck from the stars of all sensors; no sensor may have this id."""

_FIELD_POINTS = 21

_WALK_PER_SQRT_S = 0.1 / 60.0
"""Random walk of the optics errors due to temperature, in sigmas per √s; it is 0.1 sigma in an hour.

A focal length changes by 1e-5 per kelvin, and the temperature by some kelvin per night. The sigma of a surveyed focal
length is 2e-4.
"""


class StarSensorsById:
    """Star sensors by id, which are parameters of both ``ship_attitude`` and ``star_attitude``.

    A sensor with the id JOINT would publish on the topic of the joint solution, and its stars would count twice.
    """

    star_sensors: Mapping[str, "SensorWithCamera"]

    def __post_init__(self) -> None:
        """Check that no sensor has the id JOINT, and that masks do not cover the whole of a known field of view.

        Raises:
            ParameterError: a check fails; the text names the parameter.
        """
        if JOINT in self.star_sensors:
            name = f"star_sensors.{JOINT}"
            raise ParameterError(f"parameter '{name}': '{JOINT}' is reserved for all sensors: choose another id", name)
        for id_, sensor in self.star_sensors.items():
            prefix = f"star_sensors.{id_}"
            masks = sensor_masks(sensor, prefix)
            if masks is not None and sensor.camera.has_field_of_view:
                check_field_not_covered(masks, sensor.camera.field_directions(prefix), prefix)


def _coefficient(doc: str) -> Any:
    return parameter(0.0, doc=doc, minimum=-100.0, maximum=100.0)


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """Camera of a star sensor; only a sensor that measures single stars needs it."""

    focal_length_m: float = parameter(0.0, doc="focal length; 0: not given", unit="m", minimum=0.0, maximum=10.0)
    pixel_pitch_m: float = parameter(0.0, doc="pixel pitch; 0: not given", unit="m", minimum=0.0, maximum=0.001)
    principal_u_px: float = parameter(
        0.0, doc="column of the boresight; 0: centre of the first pixel", unit="px", minimum=-1e5, maximum=1e5
    )
    principal_v_px: float = parameter(
        0.0, doc="row of the boresight, downwards; 0: centre of the first pixel", unit="px", minimum=-1e5, maximum=1e5
    )
    distortion_k1: float = _coefficient("radial distortion (Brown–Conrady), r²")
    distortion_k2: float = _coefficient("radial distortion, r⁴")
    distortion_k3: float = _coefficient("radial distortion, r⁶")
    distortion_p1: float = _coefficient("tangential distortion, first")
    distortion_p2: float = _coefficient("tangential distortion, second")
    focal_length_sigma_m: float = parameter(
        0.0, doc="error of focal_length_m; 0: 0.02 % of it, as surveyed", unit="m", minimum=0.0, maximum=1.0
    )
    principal_sigma_px: float = parameter(
        1.0,
        doc="error of the principal point, each axis, in addition to that absorbed by the mounting",
        unit="px",
        minimum=0.0,
        maximum=1000.0,
    )
    distortion_sigma: float = parameter(0.01, doc="error of distortion_k1", minimum=0.0, maximum=100.0)
    centroid_sigma_px: float = parameter(
        0.1, doc="error of u and of v if the message gives none", unit="px", minimum=1e-6, maximum=100.0, live=True
    )
    psf_sigma_px: float = parameter(
        0.8,
        doc="standard deviation of the image of a star at rest, each axis; longer streaks have a worse centroid",
        unit="px",
        minimum=0.05,
        maximum=100.0,
    )
    field_spatial_sigma_px: float = parameter(
        0.0,
        doc="smooth error over the detector that remains after calibration (distortion and similar), RMS of each axis",
        unit="px",
        minimum=0.0,
        maximum=10.0,
    )
    pixel_spatial_sigma_px: float = parameter(
        0.0, doc="independent error of each pixel, each axis", unit="px", minimum=0.0, maximum=10.0
    )

    @property
    def is_given(self) -> bool:
        """True if the parameters describe a camera."""
        return self.focal_length_m > 0.0 and self.pixel_pitch_m > 0.0

    def camera(self, prefix: str) -> StarCamera:
        """Return the camera that these parameters describe.

        Args:
            prefix: name of this section of the parameters, for the error message.

        Raises:
            ParameterError: focal length or pixel pitch is missing, or a field-spatial error is given without a
                principal point; the text contains ``prefix``.
        """
        if not self.is_given:
            raise ParameterError(
                f"parameters '{prefix}.focal_length_m' and '{prefix}.pixel_pitch_m' must be given in metres: "
                "single stars are measured in pixels",
                f"{prefix}.focal_length_m",
                f"{prefix}.pixel_pitch_m",
            )
        if self.field_spatial_sigma_px > 0.0 and not self.has_field_of_view:
            raise ParameterError(
                f"parameters '{prefix}.principal_u_px' and '{prefix}.principal_v_px' must be given with "
                "field_spatial_sigma_px: they define the size of the detector",
                f"{prefix}.principal_u_px",
                f"{prefix}.principal_v_px",
            )
        distortion = Distortion(
            self.distortion_k1, self.distortion_k2, self.distortion_p1, self.distortion_p2, self.distortion_k3
        )
        return StarCamera(
            self.focal_length_m,
            self.pixel_pitch_m,
            self.principal_u_px,
            self.principal_v_px,
            None if distortion == Distortion() else distortion,
        )

    def optics_errors(self, camera: StarCamera) -> OpticsErrors:
        """Return the model of the errors of this camera's optics parameters."""
        return OpticsErrors(camera, self.focal_sigma, self.principal_sigma_px, self.distortion_sigma)

    @property
    def focal_sigma(self) -> float:
        """Relative standard deviation of the focal length; the camera must be given."""
        return self.focal_length_sigma_m / self.focal_length_m or SURVEYED_FOCAL_SIGMA

    def spatial_errors(self, camera: StarCamera) -> SpatialErrors | None:
        """Return the model of the errors that depend on the position on the detector; None without such errors."""
        if not (self.field_spatial_sigma_px or self.pixel_spatial_sigma_px):
            return None
        return SpatialErrors(camera, self.field_spatial_sigma_px, self.pixel_spatial_sigma_px)

    @property
    def has_field_of_view(self) -> bool:
        """True if the parameters define the field of view, by a principal point beyond the first row and column."""
        return self.is_given and self.principal_u_px > 0.0 and self.principal_v_px > 0.0

    def field_directions(self, prefix: str) -> FloatArray:
        """Return a grid of directions over the field of view in the sensor frame, unit vectors, shape (n, 3).

        The principal point is taken as the middle of the detector.

        Args:
            prefix: as for :meth:`camera`.

        Raises:
            ParameterError: as for :meth:`camera`.
        """
        columns = np.linspace(0.0, 2.0 * self.principal_u_px, _FIELD_POINTS)
        rows = np.linspace(0.0, 2.0 * self.principal_v_px, _FIELD_POINTS)
        return self.camera(prefix).directions(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))


@dataclass(frozen=True, kw_only=True)
class RequiredCameraConfig(CameraConfig):
    """Camera of a sensor that measures single stars; focal length and pixel pitch are required."""

    focal_length_m: float = parameter(doc="focal length", unit="m", minimum=0.001, maximum=10.0)
    pixel_pitch_m: float = parameter(doc="pixel pitch", unit="m", minimum=1e-7, maximum=0.001)


@dataclass(frozen=True, kw_only=True)
class MountingConfig(StarSensorMounting):
    """Mounting angles of a star sensor, with their standard deviations, and obstructions in its view."""

    frame_id: str = parameter("", doc="frame_id required in its messages; empty accepts any")
    masks: dict[str, MaskConfig] = mapping_of("obstructions in its view by name; no detection inside one is a star")

    @cached_property
    def sensor_masks(self) -> SensorMasks | None:
        """Deck masks in the view of the sensor; None if there are none."""
        return sensor_masks(self, "star_sensors")


class SensorWithCamera(MountedSensor, Protocol):
    """Parameters of a star sensor of either node: mounting, deck masks and camera."""

    @property
    def camera(self) -> CameraConfig:
        """Camera; only a sensor that measures single stars needs it."""


def camera_blocks(name: str, camera: CameraConfig, has_focal_length: bool = True) -> list[StateBlock]:
    """Return the blocks ``<name>.optics`` and, if the camera has a field-spatial error, ``<name>.field``.

    The states are in units of their standard deviations.

    Args:
        name: name of the camera in the names of the blocks.
        camera: parameters of the camera.
        has_focal_length: True if ``<name>.optics`` contains the focal length; False if another block contains it.
    """
    sigma = np.ones(OPTICS_MODES if has_focal_length else OPTICS_MODES - 1)
    blocks = [block(f"{name}.optics", sigma, SOURCE_OPTICS, walk=_WALK_PER_SQRT_S * sigma)]
    if camera.field_spatial_sigma_px > 0.0:
        blocks.append(block(f"{name}.field", np.ones(FIELD_MODES), SOURCE_FIELD))
    return blocks


def camera_state_indices(slices: Mapping[str, slice], name: str, focal_length: str = "") -> NDArray[np.intp] | None:
    """Return the state indices of a camera's correlated errors, focal length first; None without such states.

    Args:
        slices: slice of the filter's states for each block.
        name: name of the camera in the names of the blocks.
        focal_length: name of the block with the focal length; empty if ``<name>.optics`` contains it.
    """
    blocks = [slices[block] for block in (focal_length, f"{name}.optics", f"{name}.field") if block in slices]
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in blocks]) if blocks else None
