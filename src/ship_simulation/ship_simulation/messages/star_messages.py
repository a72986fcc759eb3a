"""Messages of star sensors: horizon attitudes, single stars, attitudes among the stars."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import SINGULAR_ELEVATION, angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import FLU_FROM_DEVICE, enu_covariance
from ship_geometry.rotations import ARCSEC
from ship_simulation.messages.ship_messages import Maker, make_quaternion, white_in_horizon
from ship_simulation.scenario.names import INERTIAL, OBSERVATIONS, STAR, star_frame
from ship_simulation.scenario.scenario import StarSensor
from ship_simulation.ship.attitude_device import DeviceSamples
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings

_STATUS_VALID, _STATUS_ANGLES_SINGULAR = 0, 2
"""StarHorizonAttitude.VALID, StarHorizonAttitude.ANGLES_SINGULAR."""


def star_maker(sensor_id: str, samples: DeviceSamples, config: StarSensor, factory: MessageFactory) -> Maker:
    """Maker of star/<id>/horizon_attitude."""
    angles = angles_from_rotation(samples.rotation_nv)
    noise_n = white_in_horizon(samples)
    total_n = noise_n + samples.common_n
    azimuths, elevations, _ = angles.T
    angle_covariances = angle_covariance(total_n, azimuths, elevations).reshape(-1, 9)
    rotation_covariances = enu_covariance(total_n).reshape(-1, 9)
    noise_covariances = enu_covariance(noise_n).reshape(-1, 9)
    # The solution's error across the boresight is that of one star over the root of their number.
    residual_rms = ARCSEC * np.hypot(config.sigma_up_arcsec, config.sigma_right_arcsec) * np.sqrt(config.star_count)

    def make(stamp: int, value: int) -> Any:
        azimuth, elevation, roll = angles[value].tolist()
        singular = abs(elevation) > SINGULAR_ELEVATION
        return factory.make(
            STAR,
            header=make_header(factory, int(samples.time_ns[stamp]), star_frame(sensor_id)),
            sensor_id=sensor_id,
            azimuth=azimuth,
            elevation=elevation,
            roll=roll,
            covariance=angle_covariances[value],
            rotation_covariance=rotation_covariances[value],
            noise_covariance=noise_covariances[value],
            star_count=config.star_count,
            rejected_count=0,
            residual_rms=float(residual_rms),
            status=_STATUS_ANGLES_SINGULAR if singular else _STATUS_VALID,
        )

    return make


def observations_maker(sensor_id: str, sightings: StarSightings, config: StarSensor, factory: MessageFactory) -> Maker:
    """Maker of star/<id>/observations."""
    stars = sightings.stars
    hip, magnitude, pixel = stars.hip.tolist(), stars.magnitude.tolist(), sightings.pixel.tolist()
    # A star with a number takes its place from the catalogue.
    numbered = stars.hip != 0
    right_ascension = np.where(numbered, np.nan, stars.positions.right_ascension).tolist()
    declination = np.where(numbered, np.nan, stars.positions.declination).tolist()

    def make_star(row: int) -> Any:
        return factory.make(
            "ship_msgs/msg/StarObservation",
            catalogue_id=hip[row],
            right_ascension=right_ascension[row],
            declination=declination[row],
            u=pixel[row][0],
            v=pixel[row][1],
            sigma_px=sightings.sigma_px,
            magnitude=magnitude[row],
        )

    def make(stamp: int, value: int) -> Any:
        rows = sightings.rows(value)
        return factory.make(
            OBSERVATIONS,
            header=make_header(factory, int(sightings.time_ns[stamp]), star_frame(sensor_id)),
            sensor_id=sensor_id,
            exposure_s=config.exposure_s,
            stars=[make_star(row) for row in range(rows.start, rows.stop)],
        )

    return make


def inertial_maker(sensor_id: str, samples: InertialSamples, factory: MessageFactory) -> Maker:
    """Maker of star/<id>/inertial_attitude."""
    # ICRS <- forward, left, up.
    quaternions = Rotation.from_matrix(samples.rotation_cv @ FLU_FROM_DEVICE.T).as_quat(canonical=True).tolist()
    covariance = (FLU_FROM_DEVICE @ samples.noise_v @ FLU_FROM_DEVICE.T).ravel()

    def make(stamp: int, value: int) -> Any:
        return factory.make(
            INERTIAL,
            header=make_header(factory, int(samples.time_ns[stamp]), star_frame(sensor_id)),
            sensor_id=sensor_id,
            orientation=make_quaternion(factory, quaternions[value]),
            covariance=covariance,
        )

    return make
