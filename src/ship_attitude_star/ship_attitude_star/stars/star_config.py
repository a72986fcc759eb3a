"""Parameters that turn pixels into directions and catalogue stars into places in the sky; two nodes share them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_attitude_star.stars.camera import Distortion, StarCamera
from ship_estimation.parameters import ParameterError, parameter


def _coefficient(doc: str) -> Any:
    return parameter(0.0, doc=doc, minimum=-100.0, maximum=100.0)


@dataclass(frozen=True, kw_only=True)
class CameraConfig:
    """The camera of a star sensor; only sensors that give single stars need one."""

    focal_length_m: float = parameter(
        0.0, doc="focal length; 0: not given", unit="m", minimum=0.0, maximum=10.0
    )
    pixel_pitch_m: float = parameter(0.0, doc="from pixel to pixel; 0: not given", unit="m", minimum=0.0, maximum=0.001)
    principal_u_px: float = parameter(
        0.0, doc="column of the boresight, from 0 at the first pixel's centre", unit="px", minimum=-1e5, maximum=1e5
    )
    principal_v_px: float = parameter(
        0.0, doc="row of the boresight, from 0 at the first pixel's centre, down", unit="px", minimum=-1e5, maximum=1e5
    )
    distortion_k1: float = _coefficient("radial distortion (Brown–Conrady), r²")
    distortion_k2: float = _coefficient("radial distortion, r⁴")
    distortion_k3: float = _coefficient("radial distortion, r⁶")
    distortion_p1: float = _coefficient("tangential distortion, first")
    distortion_p2: float = _coefficient("tangential distortion, second")
    centroid_sigma_px: float = parameter(
        0.1, doc="error of u and of v where the message gives none", unit="px", minimum=1e-6, maximum=100.0, live=True
    )
    psf_sigma_px: float = parameter(
        0.8,
        doc="spread of the image of a star at rest, each axis; a streak long against it has a worse centroid",
        unit="px",
        minimum=0.05,
        maximum=100.0,
    )

    @property
    def given(self) -> bool:
        """Whether there is a camera at all."""
        return self.focal_length_m > 0.0 and self.pixel_pitch_m > 0.0

    def camera(self, prefix: str) -> StarCamera:
        """The geometry that these parameters mean.

        Raises:
            ParameterError: focal length or pitch is missing; the text starts with ``prefix``.
        """
        if not self.given:
            raise ParameterError(
                f"parameters '{prefix}.focal_length_m' and '{prefix}.pixel_pitch_m' must be given in metres: "
                "single stars come in pixels",
                f"{prefix}.focal_length_m",
                f"{prefix}.pixel_pitch_m",
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


@dataclass(frozen=True)
class FieldOfView:
    """How a tracker sees the sky.

    Attributes:
        radius: of the field, rad; 0 for a tracker whose stars all stand at the boresight.
        aberration_removed: whether its catalogue places have aberration in them, so that it is not in the attitude.
    """

    radius: float = 0.0
    aberration_removed: bool = True


AT_BORESIGHT = FieldOfView()
"""All stars at the boresight, aberration taken out."""


@dataclass(frozen=True, kw_only=True)
class InertialConfig:
    """How a star tracker solves its attitude against the ICRS; only for ``input: inertial_attitude``."""

    aberration_removed: bool = parameter(
        True, doc="the tracker takes annual aberration out; false: its attitude is that of the stars as seen"
    )
    field_deg: float = parameter(
        20.0,
        doc="width of the tracker's field: refraction differs over it; 0: as if all its stars were at the boresight",
        unit="deg",
        minimum=0.0,
        maximum=60.0,
    )

    @property
    def field(self) -> FieldOfView:
        """What these parameters mean."""
        return FieldOfView(0.5 * float(np.deg2rad(self.field_deg)), self.aberration_removed)


@dataclass(frozen=True, kw_only=True)
class SkyConfig:
    """From the catalogue to the horizon: the air and the ship's place, how well and for how long they are known."""

    refraction_model: str = parameter(
        "erfa", doc="refraction: ERFA's refco, or the almanac's formula of [P15]", choices=("erfa", "almanac")
    )
    wavelength_um: float = parameter(
        0.55, doc="effective wavelength of the sensors' light", unit="um", minimum=0.3, maximum=2.0
    )
    pressure_hpa: float = parameter(
        1013.25, doc="air pressure at the ship without met/pressure", unit="hPa", minimum=800.0, maximum=1100.0
    )
    temperature_c: float = parameter(
        10.0, doc="air temperature without met/temperature", unit="deg C", minimum=-60.0, maximum=60.0
    )
    relative_humidity: float = parameter(0.7, doc="humidity without met/humidity, 0 to 1", minimum=0.0, maximum=1.0)
    pressure_sigma_hpa: float = parameter(
        15.0, doc="error of pressure_hpa, what an old message tends to", unit="hPa", minimum=0.0, maximum=200.0
    )
    temperature_sigma_k: float = parameter(
        10.0, doc="error of temperature_c, what an old message tends to", unit="K", minimum=0.0, maximum=60.0
    )
    measured_pressure_sigma_hpa: float = parameter(
        0.5, doc="error of met/pressure where the message gives no variance", unit="hPa", minimum=0.0, maximum=200.0
    )
    measured_temperature_sigma_k: float = parameter(
        1.0, doc="error of met/temperature where the message gives no variance", unit="K", minimum=0.0, maximum=60.0
    )
    weather_max_age_s: float = parameter(
        3600.0, doc="weather older than this is not used; its variance grows until then", unit="s", minimum=1.0
    )
    refraction_time_s: float = parameter(
        3600.0, doc="correlation time of the error of refraction", unit="s", minimum=1.0, maximum=1e7
    )
    magnitude_limit: float = parameter(
        7.0, doc="faintest star (Hp) that a detection without an identity may be", minimum=-2.0, maximum=15.0
    )
    fix_max_age_s: float = parameter(
        60.0, doc="without a fix as young as this no star is used", unit="s", minimum=0.1, maximum=3600.0
    )
    fix_sigma_m: float = parameter(
        5.0, doc="error of a fix, each horizontal axis, where the message gives none", unit="m", minimum=0.0
    )
    position_time_s: float = parameter(
        600.0, doc="correlation time of the error of the ship's position", unit="s", minimum=1.0, maximum=1e7
    )
