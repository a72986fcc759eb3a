"""Messages of star sensors: horizon attitudes, single stars, attitudes against the ICRS."""

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import SINGULAR_ELEVATION, angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import FLU_FROM_DEVICE, enu_covariance
from ship_geometry.rotations import ARCSEC, FloatArray
from ship_simulation.messages.lazy_rows import LazyRows
from ship_simulation.messages.ship_messages import Maker, angle_rows, make_quaternion, white_covariance_in_horizon
from ship_simulation.scenario.names import INERTIAL, OBSERVATIONS, STAR, star_frame
from ship_simulation.scenario.scenario import StarSensor
from ship_simulation.ship.attitude_device import DeviceSamples
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings

_STATUS_VALID, _STATUS_ANGLES_SINGULAR = 0, 2
"""StarHorizonAttitude.VALID, StarHorizonAttitude.ANGLES_SINGULAR."""


def star_maker(sensor_id: str, samples: DeviceSamples, config: StarSensor, factory: MessageFactory) -> Maker:
    """Return the maker of star/<id>/horizon_attitude."""
    angles = angle_rows(samples.rotation_nv)

    def covariances(part: slice) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        noise_n = white_covariance_in_horizon(samples, part)
        total_n = noise_n + samples.common_n
        azimuths, elevations, _ = angles_from_rotation(samples.rotation_nv[part]).T
        of_angles = angle_covariance(total_n, azimuths, elevations)
        blocks = (each.reshape(-1, 9) for each in (of_angles, enu_covariance(total_n), enu_covariance(noise_n)))
        return list(zip(*blocks, strict=True))

    rows = LazyRows(covariances)
    # The error of a solution across the boresight is the error of one star divided by the root of the number of stars.
    residual_rms = ARCSEC * np.hypot(config.sigma_up_arcsec, config.sigma_right_arcsec) * np.sqrt(config.star_count)

    def make(stamp: int, value: int) -> Any:
        azimuth, elevation, roll = angles[value]
        covariance, rotation_covariance, noise_covariance = rows[value]
        singular = abs(elevation) > SINGULAR_ELEVATION
        return factory.make(
            STAR,
            header=make_header(factory, int(samples.time_ns[stamp]), star_frame(sensor_id)),
            sensor_id=sensor_id,
            azimuth=azimuth,
            elevation=elevation,
            roll=roll,
            covariance=covariance,
            rotation_covariance=rotation_covariance,
            noise_covariance=noise_covariance,
            star_count=config.star_count,
            rejected_count=0,
            residual_rms=float(residual_rms),
            status=_STATUS_ANGLES_SINGULAR if singular else _STATUS_VALID,
        )

    return make


def observations_maker(
    sensor_id: str, frame_id: str, sightings: StarSightings, exposure_s: float, factory: MessageFactory
) -> Maker:
    """Return the maker of star/<id>/observations, and of theodolite/<id>/stars."""
    stars = sightings.stars

    def make_star(row: int) -> Any:
        # The position of a star with a number comes from the catalogue.
        numbered = stars.hip[row] != 0
        u, v = sightings.pixel[row].tolist()
        return factory.make(
            "ship_msgs/msg/StarObservation",
            catalogue_id=int(stars.hip[row]),
            right_ascension=math.nan if numbered else float(stars.positions.right_ascension[row]),
            declination=math.nan if numbered else float(stars.positions.declination[row]),
            u=u,
            v=v,
            sigma_px=sightings.sigma_px,
            magnitude=float(stars.magnitude[row]),
        )

    def make(stamp: int, value: int) -> Any:
        rows = sightings.rows(value)
        return factory.make(
            OBSERVATIONS,
            header=make_header(factory, int(sightings.time_ns[stamp]), frame_id),
            sensor_id=sensor_id,
            exposure_s=exposure_s,
            stars=[make_star(row) for row in range(rows.start, rows.stop)],
        )

    return make


def inertial_maker(sensor_id: str, samples: InertialSamples, factory: MessageFactory) -> Maker:
    """Return the maker of star/<id>/inertial_attitude."""
    # The quaternions rotate from (forward, left, up) to the ICRS.

    def quaternions_of(part: slice) -> list[list[float]]:
        rotations = Rotation.from_matrix(samples.rotation_cv[part] @ FLU_FROM_DEVICE.T)
        xyzw: list[list[float]] = rotations.as_quat(canonical=True).tolist()
        return xyzw

    quaternions = LazyRows(quaternions_of)
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
