"""From solutions to messages: axes, units, field names. Sets fields only; a factory knows the classes."""

from typing import Any

import numpy as np

from ship_attitude_star.measurements.device_config import JOINT
from ship_attitude_star.ros.ship_messages_out import DECK_FRAME
from ship_attitude_star.star_attitude.results import RefusedStar, Solved
from ship_attitude_star.stars.solution import SOLUTION_TERMS
from ship_bags.message_factory import MessageFactory
from ship_bags.stamps import make_header
from ship_geometry.frames import angle_covariance, angles_from_rotation
from ship_geometry.ros_axes import enu_covariance


def star_horizon_attitude(factory: MessageFactory, solved: Solved, frame_id: str) -> Any:
    """ship_msgs/StarHorizonAttitude; all NaN where there is no attitude."""
    solution = solved.solution
    azimuth, elevation, roll = angles_from_rotation(solution.rotation_nb).tolist()
    covariance_n = solution.covariance_n
    return factory.make(
        "ship_msgs/msg/StarHorizonAttitude",
        header=make_header(factory, solved.time_ns, frame_id),
        sensor_id=solved.sensor_id,
        azimuth=azimuth,
        elevation=elevation,
        roll=roll,
        covariance=angle_covariance(covariance_n, azimuth, elevation).ravel(),
        rotation_covariance=enu_covariance(covariance_n).ravel(),
        noise_covariance=enu_covariance(solution.noise_n).ravel(),
        star_count=solved.star_count,
        rejected_count=solved.rejected_count,
        residual_rms=solution.residual_rms if solved.valid else float("nan"),
        status=int(solution.status),
    )


def error_budget(factory: MessageFactory, solved: Solved) -> Any:
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
