"""Parameters of a theodolite, its telescopes and its beacons, which the node ``optical_axis`` and scenarios share."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ship_estimation.parameters.fields import arcsec, degrees, parameter, section
from ship_geometry.mount.axes import NAMES
from ship_geometry.rotations import ARCSEC, FloatArray

_MAX_LEVER_M = 200.0
"""Largest lever of any ship, m; a larger number is in millimetres, or wrong."""

_OF_MESSAGE = "nodes use that of the message if it states one"


def _axis_error(doc: str) -> Any:
    """Return the field of the known value of an axis error, within ±1°; larger zero points need ``fit_axes``."""
    return parameter(0.0, doc=doc, unit="arcsec", minimum=-3600.0, maximum=3600.0)


def _axis_sigma(default: float = 30.0) -> Any:
    return parameter(
        default, doc="uncertainty of this error; 0: known exactly", unit="arcsec", minimum=0.0, maximum=3600.0
    )


def _telescope_angle(doc: str) -> Any:
    return parameter(0.0, doc=doc, unit="arcsec", minimum=-36_000.0, maximum=36_000.0)


def _metres(default: float, doc: str, minimum: float, maximum: float, live: bool = False) -> Any:
    return parameter(default, doc=doc, unit="m", minimum=minimum, maximum=maximum, live=live)


@dataclass(frozen=True, kw_only=True)
class LeverConfig:
    """Surveyed vector in the axes (forward, up, right) of the ship, drone or theodolite."""

    forward_m: float = _metres(0.0, "component along forward (bow)", -_MAX_LEVER_M, _MAX_LEVER_M)
    up_m: float = _metres(0.0, "component along up", -_MAX_LEVER_M, _MAX_LEVER_M)
    right_m: float = _metres(0.0, "component along right (starboard)", -_MAX_LEVER_M, _MAX_LEVER_M)
    sigma_m: float = _metres(0.0, "standard deviation of the survey, each axis", 0.0, 10.0)

    @property
    def vector_m(self) -> FloatArray:
        """Vector in metres, shape (3,)."""
        return np.array([self.forward_m, self.up_m, self.right_m])


@dataclass(frozen=True, kw_only=True)
class AxesConfig:
    """Known values of the axis errors, and their standard deviations."""

    g_arcsec: float = _axis_error("known zero point of the azimuth encoder; the axis points at A - g")
    g_sigma_arcsec: float = _axis_sigma()
    h_arcsec: float = _axis_error("known zero point of the elevation encoder; the axis points at E - h")
    h_sigma_arcsec: float = _axis_sigma()
    c_arcsec: float = _axis_error("known collimation of the optical axis, to the left")
    c_sigma_arcsec: float = _axis_sigma()
    I_arcsec: float = _axis_error("known non-perpendicularity: tilt of the horizontal axis, right end up")
    I_sigma_arcsec: float = _axis_sigma()
    beta_x_arcsec: float = _axis_error("known tilt of the vertical axis towards the bow")
    beta_x_sigma_arcsec: float = _axis_sigma()
    beta_y_arcsec: float = _axis_error("known tilt of the vertical axis towards starboard")
    beta_y_sigma_arcsec: float = _axis_sigma()
    flexure_arcsec: float = _axis_error("known bending of the tube; it raises the axis by this times cos E")
    flexure_sigma_arcsec: float = _axis_sigma(0.0)

    @property
    def values(self) -> FloatArray:
        """Known values, in the order of :data:`ship_geometry.mount.axes.NAMES`, rad, shape (7,)."""
        return ARCSEC * np.array([getattr(self, f"{name}_arcsec") for name in NAMES])

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations of the known values, rad, shape (7,)."""
        return ARCSEC * np.array([getattr(self, f"{name}_sigma_arcsec") for name in NAMES])


@dataclass(frozen=True, kw_only=True)
class DeformationConfig:
    """Deformation of the hull between INS and theodolite, about bow, up and starboard."""

    sigma_arcsec: float = arcsec(20.0, doc="standard deviation, each axis")
    time_s: float = parameter(600.0, doc="correlation time", unit="s", minimum=1.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class TelescopeOptics:
    """Optics of the calibration telescope, its detector, and its parallelism to the main axis."""

    focal_length_m: float = parameter(doc="focal length, in metres", unit="m", minimum=0.001, maximum=10.0)
    focal_length_sigma_m: float = _metres(0.0001, "uncertainty of the focal length; 0: known exactly", 0.0, 0.1)
    principal_x_m: float = _metres(0.0, "detector point of the telescope's axis, along right", -0.1, 0.1)
    principal_z_m: float = _metres(0.0, "detector point of the telescope's axis, along up", -0.1, 0.1)
    sigma_m: float = _metres(1e-6, f"error of x and of z of a light's image; {_OF_MESSAGE}", 1e-9, 0.001, live=True)
    psf_sigma_m: float = _metres(
        5.2e-6, "spread of the image of a light at rest, each axis; a longer streak has a larger error", 1e-7, 0.001
    )
    azimuth_arcsec: float = _telescope_angle("azimuth of the main axis in the telescope")
    azimuth_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of the azimuth")
    elevation_arcsec: float = _telescope_angle("elevation of the main axis in the telescope")
    elevation_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of the elevation")
    rotation_arcsec: float = _telescope_angle("rotation of the main image in the telescope")
    rotation_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of the rotation")
    lens: LeverConfig = section(LeverConfig)

    @property
    def principal_point_m(self) -> FloatArray:
        """Detector point of the telescope's axis, shape (2,)."""
        return np.array([self.principal_x_m, self.principal_z_m])

    @property
    def parallelism(self) -> FloatArray:
        """Azimuth, elevation and rotation of the main axis in the telescope, rad, shape (3,)."""
        return ARCSEC * np.array([self.azimuth_arcsec, self.elevation_arcsec, self.rotation_arcsec])

    @property
    def parallelism_sigma(self) -> FloatArray:
        """Standard deviations of the parallelism, rad, shape (3,)."""
        return ARCSEC * np.array([self.azimuth_sigma_arcsec, self.elevation_sigma_arcsec, self.rotation_sigma_arcsec])


@dataclass(frozen=True, kw_only=True)
class MainAxisInCamera:
    """Orientation of the main axis in a star camera that is fixed to the theodolite.

    The main frame is the camera's frame rotated by R(azimuth, elevation, roll), with the signs of
    ``telescope.azimuth_arcsec``, ``elevation_arcsec`` and ``rotation_arcsec``.
    """

    azimuth_deg: float = degrees(doc="azimuth of the main axis in the camera")
    azimuth_sigma_arcsec: float = arcsec(1.0, doc="uncertainty of the azimuth")
    elevation_deg: float = parameter(
        doc="elevation of the main axis in the camera", unit="deg", minimum=-89.0, maximum=89.0
    )
    elevation_sigma_arcsec: float = arcsec(1.0, doc="uncertainty of the elevation")
    roll_deg: float = degrees(doc="rotation of the main image in the camera")
    roll_sigma_arcsec: float = arcsec(20.0, doc="uncertainty of the rotation")

    @property
    def parallelism(self) -> FloatArray:
        """Azimuth, elevation and roll of the main axis in the camera, rad, shape (3,)."""
        return np.deg2rad([self.azimuth_deg, self.elevation_deg, self.roll_deg])

    @property
    def parallelism_sigma(self) -> FloatArray:
        """Standard deviations of the parallelism, rad, shape (3,)."""
        return ARCSEC * np.array([self.azimuth_sigma_arcsec, self.elevation_sigma_arcsec, self.roll_sigma_arcsec])


@dataclass(frozen=True, kw_only=True)
class MainDetectorOptics:
    """Optics of the main tube and its detector, for images of targets; a focal length of 0 means no detector."""

    focal_length_m: float = _metres(
        0.0, "focal length of the main tube, in metres; 0: no main detector, images of targets are not used", 0.0, 100.0
    )
    focal_length_sigma_m: float = _metres(0.0, "uncertainty of the focal length", 0.0, 1.0)
    principal_x_m: float = _metres(0.0, "detector point of the main axis, along right", -0.5, 0.5)
    principal_z_m: float = _metres(0.0, "detector point of the main axis, along up", -0.5, 0.5)
    principal_sigma_m: float = _metres(0.0, "uncertainty of the detector point, each axis", 0.0, 0.1)
    sigma_m: float = _metres(1e-6, f"error of x and of z of a target's image; {_OF_MESSAGE}", 1e-9, 0.001, live=True)
    rotation_sigma_arcsec: float = arcsec(0.0, doc="uncertainty of detector_rotation as the message gives it")

    @property
    def principal_point_m(self) -> FloatArray:
        """Detector point of the main axis, shape (2,)."""
        return np.array([self.principal_x_m, self.principal_z_m])


@dataclass(frozen=True, kw_only=True)
class AirConfig:
    """Coefficient k of terrestrial refraction on the paths to beacons and to a target with a range."""

    coefficient: float = parameter(0.13, doc="k near the sea", minimum=-5.0, maximum=5.0)
    sigma: float = parameter(0.06, doc="error of k, common to all lights", minimum=0.0, maximum=5.0)
    light_sigma: float = parameter(0.02, doc="further error of k on the path to each light", minimum=0.0, maximum=5.0)
    time_s: float = parameter(3600.0, doc="correlation time of both errors", unit="s", minimum=0.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class ShipAntennaConfig:
    """Antenna aboard from which all baselines start, so that its error is common to all baselines."""

    sigma_m: float = _metres(0.01, "correlated error, each axis", 0.0, 10.0)
    time_s: float = parameter(300.0, doc="correlation time of the error", unit="s", minimum=0.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class BaselineErrors:
    """Errors of the baseline from the ship's antenna to a drone's antenna."""

    sigma_m: float = _metres(0.02, f"noise of each solution, each axis; {_OF_MESSAGE}", 1e-4, 100.0, live=True)
    bias_sigma_m: float = _metres(0.01, "correlated error, each axis, in addition to the stated one", 0.0, 100.0)
    bias_time_s: float = parameter(300.0, doc="correlation time of bias_sigma_m", unit="s", minimum=0.0, maximum=1e7)


@dataclass(frozen=True, kw_only=True)
class DroneAttitudeErrors:
    """Errors of the attitude of a drone."""

    tilt_sigma_deg: float = parameter(
        0.3, doc="correlated error in tilt, each axis", unit="deg", minimum=0.0, maximum=90.0
    )
    heading_sigma_deg: float = parameter(1.0, doc="correlated error in heading", unit="deg", minimum=0.0, maximum=90.0)
    time_s: float = parameter(300.0, doc="correlation time of both errors", unit="s", minimum=0.0, maximum=1e7)
