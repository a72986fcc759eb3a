"""Message with the advised positions of the drones."""

from typing import TYPE_CHECKING, Any

from ship_bags.message_factory import MessageFactory
from ship_estimation.parameters.frame_names import FRAME_NAMES
from ship_geometry.ros_axes import ENU_FROM_HORIZON

if TYPE_CHECKING:
    from theodolite_calib.escort.advice import EscortAdvice

ESCORT_TOPIC, ESCORT_TYPE = "theodolite/escort", "ship_msgs/msg/EscortAdvice"


def escort_message(
    factory: MessageFactory, advice: "EscortAdvice", time_ns: int, horizon: str = FRAME_NAMES.horizon
) -> Any:
    """Return ship_msgs/EscortAdvice for the pointing at a time; positions are NaN if no position meets the limits."""
    places = (advice.places_n @ ENU_FROM_HORIZON.T).tolist()
    return factory.make(
        ESCORT_TYPE,
        header={"stamp": time_ns, "frame_id": horizon},
        beacon_ids=list(advice.names),
        places=[dict(zip("xyz", place, strict=True)) for place in places],
        sigma_now=advice.sigma_now,
        sigma_advised=advice.sigma_advised,
        limits_reached=list(advice.limits_reached),
    )
