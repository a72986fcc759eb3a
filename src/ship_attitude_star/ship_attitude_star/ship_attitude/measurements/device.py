"""Base class of the devices of all kinds of measurement, and the terms in which a measurement is linearised.

A new kind of sensor has a measurement and a subclass of :class:`Device` in this folder, its parameters in
:mod:`ship_attitude_star.ship_attitude.config`, and its reader in :mod:`ship_attitude_star.messages.input_messages`
(``docs/develop/add_a_sensor.md``). Another sensor of a known kind needs only parameters.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ship_attitude_star.vertical.vertical_track import VerticalTrack
from ship_estimation.kalman.kalman_filter import LinearMeasurement, StateBlock, StateModel
from ship_estimation.rejection_rules import Rejection
from ship_estimation.time_order.outcome import Measurement
from ship_geometry.rotations import FloatArray
from ship_geometry.tracks.attitude_track import AttitudeTrack, InterpolatedAttitude
from ship_stars.attitude_from_stars.selection import StarPrior
from ship_stars.sky.sky_model import SkyModel

SOURCE_INTERPOLATION = "interpolation"
"""Error source of the interpolation of the INS attitude."""


class PredictedAttitude(NamedTuple):
    """Attitude of a device predicted from the state.

    Attributes:
        rotation_nv: horizon from device, shape (3, 3).
        jacobian_v: Jacobian of the rotation vector in the device frame with respect to the state, shape (3, n).
        interpolation_v: covariance of the interpolation error of the INS attitude, rotation vector in the device
            frame, rad², shape (3, 3).
    """

    rotation_nv: FloatArray
    jacobian_v: FloatArray
    interpolation_v: FloatArray

    def prior(self, covariance: FloatArray) -> StarPrior:
        """Return the prior for the selection of stars, from the covariance of the state, shape (n, n)."""
        prior_v = self.jacobian_v @ covariance @ self.jacobian_v.T + self.interpolation_v
        return StarPrior(self.rotation_nv, self.rotation_nv @ prior_v @ self.rotation_nv.T)


class InsMatch(NamedTuple):
    """The INS attitude that is matched to a measurement, and the data with which a measurement is converted.

    Attributes:
        ins: interpolated attitude of the INS.
        ins_time_ns: stamp of this attitude.
        track: attitudes of the INS.
        sky_model: sky model; None if no sensor needs it.
        vertical: vertical along the track; None if the deflection is not modelled.
    """

    ins: InterpolatedAttitude
    ins_time_ns: int
    track: AttitudeTrack
    sky_model: SkyModel | None
    vertical: VerticalTrack | None


class LinearisationPoint(NamedTuple):
    """State at which a measurement is linearised.

    Attributes:
        model: state vector.
        mean: mean of the state, shape (n,).
        covariance: covariance of the predicted state, shape (n, n).
        predicted: attitude of the device at ``mean``.
        sky_model: sky model; None if no sensor needs it.
        expected: attitude of the device at the predicted mean, if ``mean`` is another linearisation point; stars are
            selected with this attitude.
    """

    model: StateModel
    mean: FloatArray
    covariance: FloatArray
    predicted: PredictedAttitude
    sky_model: SkyModel | None
    expected: PredictedAttitude | None = None


class ComparedMeasurement(NamedTuple):
    """A measurement compared with its prediction.

    Attributes:
        linear: residual, rad, shape (m,), with its Jacobian with respect to the state and its noise by source.
        rotation_jacobian: Jacobian of the residual with respect to a rotation vector in the device frame, shape (m, 3).
        components: names of the residual components.
        rotation_nv: measured attitude, horizon from device, shape (3, 3); the predicted attitude if the single stars
            are consistent with it.
        predicted_nv: predicted attitude, horizon from device, shape (3, 3).
        attitude_noise_v: noise of a measured attitude, rotation vector in the device frame, rad², shape (3, 3); zero
            for other measurements.
        rejected_stars: rejected stars by name.
    """

    linear: LinearMeasurement
    rotation_jacobian: FloatArray
    components: tuple[str, ...]
    rotation_nv: FloatArray
    predicted_nv: FloatArray
    attitude_noise_v: FloatArray = np.zeros((3, 3))
    rejected_stars: tuple[tuple[str, Rejection], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Device(ABC):
    """A device fixed to the ship, with mounting, clock and error sources; a subclass models its kind of measurement.

    Attributes:
        name: source name, as ``star.<id>``; also the prefix of the names of its states.
        parameters: name of its section of parameters, as ``star_sensors.<id>``.
        heading_parameter: name of the parameter of its mounting that determines the heading.
        rotation_dv0: configured mounting, deck from device, shape (3, 3).
        ins_time_s: configured part of (stamp of the INS - stamp of the device) for the same attitude, s.
        ins_time_states: states that add to ``ins_time_s``, with their signs.
        noise_sources: error sources of its noise, the white noise first.
        blocks: states of its errors.
        time_offset_s: configured offset of its own clock, s; None if the stamps need no offset.
        is_star: True for star sensors, which alone measure the full attitude relative to the geodetic horizon.
        angles: name and index of the estimated mounting angles (azimuth, elevation, roll) of the alignment.
        are_angles_signed: True if these angles are differences, wrapped to [-pi, pi).
    """

    name: str
    parameters: str
    heading_parameter: str
    rotation_dv0: FloatArray
    ins_time_s: float
    ins_time_states: tuple[tuple[str, float], ...]
    noise_sources: tuple[str, ...]
    blocks: tuple[StateBlock, ...]
    time_offset_s: float | None = None
    is_star: ClassVar[bool] = False
    angles: ClassVar[tuple[tuple[str, int], ...]] = (("azimuth", 0), ("elevation", 1), ("roll", 2))
    are_angles_signed: ClassVar[bool] = False

    def convert(self, measurement: Any, match: InsMatch) -> tuple[Measurement, InterpolatedAttitude] | Rejection:
        """Return the measurement as it is linearised, and the INS attitude of its prediction; or its rejection."""
        return measurement, match.ins

    def initial_attitude(self, measurement: Any, at: LinearisationPoint) -> FloatArray | None:
        """Return an attitude (horizon from device) to begin an iteration with; None for the predicted attitude."""
        return None

    @abstractmethod
    def linearise(self, measurement: Any, at: LinearisationPoint) -> ComparedMeasurement | Rejection:
        """Return residual, Jacobian and noise of a converted measurement at a state; or its rejection."""

    @abstractmethod
    def information(self, measurement: Any) -> FloatArray:
        """Return the information about a rotation of the device (forward, up, right), 1/rad², shape (3, 3)."""
