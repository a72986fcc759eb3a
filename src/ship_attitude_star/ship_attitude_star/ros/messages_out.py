"""From results of both cores to messages: axes, units, field names. Sets fields only; a factory knows the classes."""

from typing import Any

import numpy as np

from ship_attitude_star.measurements.samples import AttitudeDecision, AttitudeEstimate
from ship_attitude_star.ship_attitude.alignment import Alignment
from ship_attitude_star.star_attitude.exposure_solver import RefusedStar, Solved
from ship_attitude_star.stars.config import JOINT
from ship_attitude_star.stars.solution import SOLUTION_TERMS
from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_estimation.outcome import Status
from ship_estimation.refusals import Reason
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance, flu_from_device_vector, quaternion_from_rotation
from ship_geometry.rotations import ARCSEC, FloatArray

DECK_FRAME = "deck"
_NOT_GIVEN = np.array([-1.0] + [0.0] * 8)


def ship_attitude(factory: MessageFactory, estimate: AttitudeEstimate) -> Any:
    """ship_msgs/ShipAttitude; all NaN where no attitude is claimed."""
    angles, covariance = _angles(estimate)
    return factory.make(
        "ship_msgs/msg/ShipAttitude",
        header=make_header(factory, estimate.time_ns, DECK_FRAME),
        heading=float(angles[0]),
        pitch=float(angles[1]),
        roll=float(angles[2]),
        covariance=covariance.ravel(),
        orientation=_orientation(factory, estimate),
        rotation_covariance=enu_covariance(estimate.covariance_n).ravel(),
        angular_velocity=_vector(factory, flu_from_device_vector(estimate.rate_d)),
        status=int(estimate.status),
        horizon=int(estimate.horizon),
        sources=list(estimate.sources),
        star_age_s=estimate.star_age_s,
    )


def ship_imu(factory: MessageFactory, estimate: AttitudeEstimate) -> Any:
    """sensor_msgs/Imu: the same attitude for standard tools; no acceleration, the rate where it is known."""
    rate_known = bool(np.all(np.isfinite(estimate.rate_d)))
    rate = estimate.rate_d if rate_known else np.zeros(3)
    return factory.make(
        "sensor_msgs/msg/Imu",
        header=make_header(factory, estimate.time_ns, DECK_FRAME),
        orientation=_orientation(factory, estimate),
        orientation_covariance=enu_covariance(estimate.covariance_n).ravel(),
        angular_velocity=_vector(factory, flu_from_device_vector(rate)),
        angular_velocity_covariance=np.zeros(9) if rate_known else _NOT_GIVEN,
        linear_acceleration=_vector(factory, np.zeros(3)),
        linear_acceleration_covariance=_NOT_GIVEN,
    )


def error_budget(factory: MessageFactory, estimate: AttitudeEstimate, sources: list[str]) -> Any:
    """ship_msgs/ErrorBudget of a published attitude."""
    return factory.make(
        "ship_msgs/msg/ErrorBudget",
        header=make_header(factory, estimate.time_ns, DECK_FRAME),
        quantity="ship_attitude",
        sources=list(sources),
        covariances=enu_covariance(estimate.covariance_parts_n).ravel(),
        total=enu_covariance(estimate.covariance_n).ravel(),
    )


def error_arcsec(factory: MessageFactory, estimate: AttitudeEstimate) -> Any:
    """ship_msgs/AttitudeErrorArcsec: predicted sigmas; an estimator never sees the truth, so errors are NaN."""
    _, covariance = _angles(estimate)
    sigma = np.sqrt(np.diagonal(covariance)) / ARCSEC
    unknown = float("nan")
    return factory.make(
        "ship_msgs/msg/AttitudeErrorArcsec",
        header=make_header(factory, estimate.time_ns, DECK_FRAME),
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
        header=make_header(factory, now_ns, DECK_FRAME),
        names=list(alignment.names),
        values=alignment.values,
        covariance=alignment.covariance.ravel(),
        units=list(alignment.units),
    )


def innovation(factory: MessageFactory, decision: AttitudeDecision) -> Any:
    """ship_msgs/Innovation of a measurement that was judged."""
    reason, text = decision.reason, decision.text
    if decision.accepted and not decision.measurement.covariance_known:
        reason, text = Reason.COVARIANCE_UNKNOWN, "the message gives no covariance: used with the configured sigma"
    if decision.revised:
        verdict = "now used" if decision.accepted else f"now refused: {reason.word}"
        reason, text = Reason.REVISED, f"judged anew after a measurement that arrived late, {verdict} {text}".rstrip()
    return factory.make(
        "ship_msgs/msg/Innovation",
        header=make_header(factory, decision.measurement.time_ns, decision.measurement.source),
        source=decision.measurement.source,
        components=list(decision.components),
        residual=decision.residual,
        sigma=decision.sigma,
        nis=float(decision.nis),
        gate=float(decision.gate),
        accepted=decision.accepted,
        reason=int(reason),
        reason_text=text,
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


def star_error_budget(factory: MessageFactory, solved: Solved) -> Any:
    """ship_msgs/ErrorBudget of a joint solution."""
    return factory.make(
        "ship_msgs/msg/ErrorBudget",
        header=make_header(factory, solved.time_ns, DECK_FRAME),
        quantity=f"star_{JOINT}",
        sources=list(SOLUTION_TERMS),
        covariances=enu_covariance(solved.solution.parts_n).ravel(),
        total=enu_covariance(solved.solution.covariance_n).ravel(),
    )


def refused_star(factory: MessageFactory, star: RefusedStar) -> Any:
    """ship_msgs/Innovation of a star that was refused, compared with its place or not."""
    residual = np.array(star.residual)
    compared = len(residual) > 0
    return factory.make(
        "ship_msgs/msg/Innovation",
        header=make_header(factory, star.time_ns, star.source),
        source=star.source,
        components=["up", "right"] if compared else [],
        residual=residual,
        sigma=np.full(len(residual), star.sigma),
        nis=float(residual @ residual / star.sigma**2) if compared else float("nan"),
        gate=float("nan"),
        accepted=False,
        reason=int(star.refusal.reason),
        reason_text=f"{star.name}: {star.refusal.text}",
    )


def _angles(estimate: AttitudeEstimate) -> tuple[FloatArray, FloatArray]:
    """Heading, pitch, roll (rad) and their covariance (rad²)."""
    angles = angles_from_rotation(estimate.rotation_nd)
    return angles, angle_covariance(estimate.covariance_n, angles[0], angles[1])


def _orientation(factory: MessageFactory, estimate: AttitudeEstimate) -> Any:
    claimed = estimate.status is not Status.INVALID
    x, y, z, w = quaternion_from_rotation(estimate.rotation_nd).tolist() if claimed else [float("nan")] * 4
    return factory.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _vector(factory: MessageFactory, vector: FloatArray) -> Any:
    x, y, z = vector.tolist()
    return factory.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)
