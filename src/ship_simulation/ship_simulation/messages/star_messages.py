"""Messages of star sensors that look at the real sky."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.ros_axes import FLU_FROM_DEVICE
from ship_simulation.messages.ship_messages import Maker, make_quaternion, star_frame
from ship_simulation.scenario.names import INERTIAL, OBSERVATIONS
from ship_simulation.scenario.scenario import StarSensor
from ship_simulation.stars.star_sightings import InertialSamples, StarSightings


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
