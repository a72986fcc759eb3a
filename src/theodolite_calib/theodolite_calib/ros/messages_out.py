"""From the core's results to messages: axes, units, field names. Sets fields only; a factory knows the classes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ship_bags.message_factory import MessageFactory
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance
from ship_geometry.rotations import ARCSEC
from ship_node.edge.messages_out import error_budget
from ship_node.edge.topics import Published
from theodolite_calib.measured.samples import PointingEstimate
from theodolite_calib.optical_axis.calibration import Calibration

MAIN_FRAME = "theodolite_main"
BASE_FRAME = "theodolite_base"
POINTING_TOPIC = "theodolite/pointing"


def pointing_messages(factory: MessageFactory, estimate: PointingEstimate) -> list[Published]:
    """What a pointing becomes: ship_msgs/OpticalAxisPointing; all NaN where no pointing is claimed."""
    azimuth, elevation, image_rotation = angles_from_rotation(estimate.rotation_nm).tolist()
    telescope_azimuth, telescope_elevation, telescope_rotation = angles_from_rotation(estimate.rotation_nt).tolist()
    angles_covariance = angle_covariance(estimate.covariance_n, azimuth, elevation)
    message = factory.make(
        "ship_msgs/msg/OpticalAxisPointing",
        header={"stamp": estimate.time_ns, "frame_id": MAIN_FRAME},
        azimuth=azimuth,
        elevation=elevation,
        image_rotation=image_rotation,
        covariance=angles_covariance.ravel(),
        rotation_covariance=enu_covariance(estimate.covariance_n).ravel(),
        telescope_azimuth=telescope_azimuth,
        telescope_elevation=telescope_elevation,
        telescope_rotation=telescope_rotation,
        mode=int(estimate.mode),
        status=int(estimate.status),
        light_count=estimate.light_count,
    )
    return [(POINTING_TOPIC, message)]


def pointing_budget(factory: MessageFactory, estimate: PointingEstimate, sources: Sequence[str]) -> Any:
    """ship_msgs/ErrorBudget of a published pointing; ``sources`` name the parts of its covariance."""
    parts_n, covariance_n = estimate.parts_n, estimate.covariance_n
    return error_budget(factory, "optical_axis", estimate.time_ns, MAIN_FRAME, sources, parts_n, covariance_n)


def error_arcsec(factory: MessageFactory, estimate: PointingEstimate) -> Any:
    """ship_msgs/PointingErrorArcsec: predicted sigmas; an estimator never sees the truth, so errors are NaN."""
    azimuth, elevation, _ = angles_from_rotation(estimate.rotation_nm)
    sigma = np.sqrt(np.diagonal(angle_covariance(estimate.covariance_n, azimuth, elevation))) / ARCSEC
    unknown = float("nan")
    return factory.make(
        "ship_msgs/msg/PointingErrorArcsec",
        header={"stamp": estimate.time_ns, "frame_id": MAIN_FRAME},
        sigma_azimuth_cos_elevation=float(sigma[0] * np.cos(elevation)),
        sigma_elevation=float(sigma[1]),
        sigma_image_rotation=float(sigma[2]),
        error_azimuth_cos_elevation=unknown,
        error_elevation=unknown,
        error_image_rotation=unknown,
    )


def calibration(factory: MessageFactory, values: Calibration, now_ns: int) -> Any:
    """ship_msgs/TheodoliteCalibration, stamped with the last sighting, or now where there was none."""
    return factory.make(
        "ship_msgs/msg/TheodoliteCalibration",
        header={"stamp": values.time_ns or now_ns, "frame_id": BASE_FRAME},
        names=list(values.names),
        values=values.values,
        covariance=values.covariance.ravel(),
        units=list(values.units),
        unobservable=list(values.unobservable),
        sighting_count=values.sighting_count,
        residual_rms=values.residual_rms,
    )
