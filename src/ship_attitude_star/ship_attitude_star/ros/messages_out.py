"""From results of both cores to messages: axes, units, field names. Sets fields only; a factory knows the classes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeEstimate
from ship_attitude_star.ship_attitude.alignment import Alignment
from ship_attitude_star.star_attitude.exposure_solver import RefusedStar, Solved
from ship_attitude_star.stars.config import JOINT
from ship_attitude_star.stars.solution import SOLUTION_TERMS
from ship_bags.message_factory import MessageFactory
from ship_estimation.outcome import Status
from ship_estimation.refusals import Refusal
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance, flu_from_device_vector, quaternion_from_rotation
from ship_geometry.rotations import ARCSEC
from ship_node.edge.messages_out import error_budget, refused_input
from ship_node.edge.topics import Published

DECK_FRAME = "deck"
ATTITUDE_TOPIC, IMU_TOPIC = "ship/attitude", "ship/imu"

_NOT_GIVEN = np.array([-1.0] + [0.0] * 8)


def attitude_messages(factory: MessageFactory, estimate: AttitudeEstimate) -> list[Published]:
    """What an attitude becomes: ship_msgs/ShipAttitude and, for standard tools, the same as sensor_msgs/Imu.

    Where no attitude is claimed the first is all NaN, and the second is not made.
    """
    claimed = estimate.status is not Status.INVALID
    covariance_n = estimate.covariance_n
    heading, pitch, roll = angles_from_rotation(estimate.rotation_nd).tolist()
    angles_covariance = angle_covariance(covariance_n, heading, pitch)
    header = {"stamp": estimate.time_ns, "frame_id": DECK_FRAME}
    quaternion = quaternion_from_rotation(estimate.rotation_nd) if claimed else np.full(4, np.nan)
    rotation_covariance = enu_covariance(covariance_n).ravel()
    rate_flu = flu_from_device_vector(estimate.rate_d)
    rate_known = bool(np.all(np.isfinite(rate_flu)))
    orientation = dict(zip("xyzw", quaternion.tolist(), strict=True))
    rate = dict(zip("xyz", rate_flu.tolist(), strict=True))
    nothing = dict.fromkeys("xyz", 0.0)
    attitude = factory.make(
        "ship_msgs/msg/ShipAttitude",
        header=header,
        heading=heading,
        pitch=pitch,
        roll=roll,
        covariance=angles_covariance.ravel(),
        orientation=orientation,
        rotation_covariance=rotation_covariance,
        angular_velocity=rate,
        status=int(estimate.status),
        horizon=int(estimate.horizon),
        sources=list(estimate.sources),
        star_age_s=estimate.star_age_s,
    )
    if not claimed:
        return [(ATTITUDE_TOPIC, attitude)]
    # No acceleration; the rate where it is known.
    imu = factory.make(
        "sensor_msgs/msg/Imu",
        header=header,
        orientation=orientation,
        orientation_covariance=rotation_covariance,
        angular_velocity=rate if rate_known else nothing,
        angular_velocity_covariance=np.zeros(9) if rate_known else _NOT_GIVEN,
        linear_acceleration=nothing,
        linear_acceleration_covariance=_NOT_GIVEN,
    )
    return [(ATTITUDE_TOPIC, attitude), (IMU_TOPIC, imu)]


def attitude_budget(factory: MessageFactory, estimate: AttitudeEstimate, sources: Sequence[str]) -> Any:
    """ship_msgs/ErrorBudget of a published attitude; ``sources`` name the parts of its covariance."""
    parts_n, covariance_n = estimate.covariance_parts_n, estimate.covariance_n
    return error_budget(factory, "ship_attitude", estimate.time_ns, DECK_FRAME, sources, parts_n, covariance_n)


def error_arcsec(factory: MessageFactory, estimate: AttitudeEstimate) -> Any:
    """ship_msgs/AttitudeErrorArcsec: predicted sigmas; an estimator never sees the truth, so errors are NaN."""
    heading, pitch, _ = angles_from_rotation(estimate.rotation_nd)
    sigma = np.sqrt(np.diagonal(angle_covariance(estimate.covariance_n, heading, pitch))) / ARCSEC
    unknown = float("nan")
    return factory.make(
        "ship_msgs/msg/AttitudeErrorArcsec",
        header={"stamp": estimate.time_ns, "frame_id": DECK_FRAME},
        sigma_heading=float(sigma[0]),
        sigma_pitch=float(sigma[1]),
        sigma_roll=float(sigma[2]),
        error_heading=unknown,
        error_pitch=unknown,
        error_roll=unknown,
    )


def alignment_state(factory: MessageFactory, alignment: Alignment, now_ns: int) -> Any:
    """ship_msgs/AlignmentState."""
    return factory.make(
        "ship_msgs/msg/AlignmentState",
        header={"stamp": now_ns, "frame_id": DECK_FRAME},
        names=list(alignment.names),
        values=alignment.values,
        covariance=alignment.covariance.ravel(),
        units=list(alignment.units),
    )


def star_horizon_attitude(factory: MessageFactory, solved: Solved, frame_id: str) -> Any:
    """ship_msgs/StarHorizonAttitude; all NaN where there is no attitude."""
    solution = solved.solution
    covariance_n, noise_n, residual_rms = solution.covariance_n, solution.noise_n, solution.residual_rms
    star_count = solution.star_count
    azimuth, elevation, roll = angles_from_rotation(solution.rotation_nb).tolist()
    covariance = angle_covariance(covariance_n, azimuth, elevation)
    return factory.make(
        "ship_msgs/msg/StarHorizonAttitude",
        header={"stamp": solved.time_ns, "frame_id": frame_id},
        sensor_id=solved.sensor_id,
        azimuth=azimuth,
        elevation=elevation,
        roll=roll,
        covariance=covariance.ravel(),
        rotation_covariance=enu_covariance(covariance_n).ravel(),
        noise_covariance=enu_covariance(noise_n).ravel(),
        star_count=star_count,
        rejected_count=len(solved.refused),
        residual_rms=residual_rms,
        status=int(solution.status),
    )


def solution_budget(factory: MessageFactory, solved: Solved) -> Any:
    """ship_msgs/ErrorBudget of a joint solution."""
    parts_n, covariance_n = solved.solution.parts_n, solved.solution.covariance_n
    return error_budget(factory, f"star_{JOINT}", solved.time_ns, DECK_FRAME, SOLUTION_TERMS, parts_n, covariance_n)


def refused_star(factory: MessageFactory, star: RefusedStar) -> Any:
    """ship_msgs/Innovation of a star that was refused, compared with its place or not."""
    told = Refusal(star.refusal.reason, f"{star.name}: {star.refusal.text}")
    if not star.residual:
        return refused_input(factory, star.source, star.time_ns, told)
    residual = np.array(star.residual)
    nis = float(residual @ residual / star.sigma**2)
    sigma = np.full(len(residual), star.sigma)
    return refused_input(factory, star.source, star.time_ns, told, ("up", "right"), residual, sigma, nis)
