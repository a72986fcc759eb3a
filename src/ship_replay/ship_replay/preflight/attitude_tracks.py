"""Prediction of a camera's attitude in a bag, from the ship's attitude and, on the theodolite, the encoders."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ship_bags.stamps import NS_PER_S
from ship_geometry.frames import rotation_from_angles
from ship_geometry.mount.axes import AxisErrors, main_axis_rotation
from ship_geometry.rotations import ARCSEC
from ship_geometry.tracks.attitude_track import AttitudeTrack
from ship_geometry.tracks.vector_track import VectorTrack
from ship_stars.solution.selection import StarPrior
from theodolite_calib.config import OpticalAxisConfig, StarCameraConfig
from theodolite_calib.samples.samples import EncoderSample

ENCODER_TOPIC = "theodolite/encoder"
_FULL_TURN = 2.0 * np.pi


@dataclass
class AttitudeTracks:
    """Samples of a bag that predict the attitude of a camera.

    Attributes:
        config: configuration of the node.
        ship_topic: topic of the ship's attitude.
        ship: attitudes of the ship.
        encoder: readings of the theodolite's encoders.
    """

    config: Any
    ship_topic: str
    ship: AttitudeTrack = field(init=False)
    encoder: VectorTrack[EncoderSample] = field(init=False)

    def __post_init__(self) -> None:
        on_mount = isinstance(self.config, OpticalAxisConfig)
        self.ship = AttitudeTrack(round(self.config.ins.max_gap_s * NS_PER_S))
        self.encoder = VectorTrack(round(self.config.encoder.max_gap_s * NS_PER_S) if on_mount else 1, _FULL_TURN)

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics of the samples."""
        return (self.ship_topic, ENCODER_TOPIC) if isinstance(self.config, OpticalAxisConfig) else (self.ship_topic,)

    def predicted_attitude(self, device: Any, time_ns: int) -> StarPrior | None:
        """Return the attitude of a camera (horizon from sensor) with its error covariance; None if unknown."""
        ship, ins = self.ship.at(time_ns + offset_ns(device)), self.config.ins
        if ship is None:
            return None
        sigma_arcsec = np.array([ins.tilt_sigma_arcsec, ins.heading_sigma_arcsec, ins.tilt_sigma_arcsec])
        covariance_n = np.diag((sigma_arcsec * ARCSEC) ** 2)
        if not isinstance(device, StarCameraConfig):
            rotation_ns = ship.rotation_nd @ device.rotation_ds
            mounting_n = rotation_ns * device.installation_sigma_s
            return StarPrior(rotation_ns, covariance_n + mounting_n @ mounting_n.T)
        angles = self.encoder.at(time_ns)
        if angles is None:
            return None
        axes = AxisErrors.from_vector(self.config.axes.values)
        rotation_dm = main_axis_rotation(axes, float(angles.vector[0]), float(angles.vector[1]))
        rotation_sm = rotation_from_angles(*device.parallelism)
        deformation = self.config.deformation.sigma_arcsec * ARCSEC
        own = np.array([*self.config.axes.sigma, *device.parallelism_sigma, deformation])
        # An upper bound: each of these errors rotates the camera by at most its own size.
        covariance_n += own @ own * np.eye(3)
        return StarPrior(ship.rotation_nd @ rotation_dm @ rotation_sm.T, covariance_n)


def offset_ns(device: Any) -> int:
    """Return the time offset of a device, ns: data are valid at their stamp plus this offset."""
    return round(getattr(device, "time_offset_s", 0.0) * NS_PER_S)
