"""Message of a target's direction, ship_msgs/TargetDirection, with vectors in (East, North, Up)."""

from collections.abc import Callable
from typing import Any

from ship_bags.message_factory import MessageFactory
from ship_geometry.ros_axes import ENU_FROM_HORIZON, enu_covariance
from ship_geometry.rotations import FloatArray
from theodolite_calib.samples.samples import TargetEstimate
from theodolite_calib.targets.direction import direction_angles

TARGET_TOPIC, TARGET_TYPE = "theodolite/target_direction", "ship_msgs/msg/TargetDirection"


def target_message(factory: MessageFactory, estimate: TargetEstimate, frame_id: str) -> Any:
    """Return ship_msgs/TargetDirection of one image; all numbers are NaN if INVALID."""
    (azimuth, elevation), covariance = direction_angles(estimate.direction_n, estimate.covariance_n)
    make: Callable[..., Any] = factory.make
    return make(
        TARGET_TYPE,
        header={"stamp": estimate.time_ns, "frame_id": frame_id},
        target_id=estimate.target_id,
        azimuth=float(azimuth),
        elevation=float(elevation),
        covariance=covariance.ravel(),
        direction=_enu(estimate.direction_n),
        direction_covariance=enu_covariance(estimate.covariance_n).ravel(),
        position=_enu(estimate.position_n),
        position_covariance=enu_covariance(estimate.position_covariance_n).ravel(),
        status=int(estimate.status),
    )


def _enu(vector_n: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", (ENU_FROM_HORIZON @ vector_n).tolist(), strict=True))
