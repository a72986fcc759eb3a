"""Stamps of messages to and from integer nanoseconds of POSIX UTC."""

from typing import Any

from ship_node.message_factory import MessageFactory

_NS_PER_S = 1_000_000_000


def ns_from_stamp(stamp: Any) -> int:
    """Nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * _NS_PER_S + int(stamp.nanosec)


def stamp_fields(ns: int) -> tuple[int, int]:
    """Fields (sec, nanosec) of a builtin_interfaces/Time."""
    return divmod(ns, _NS_PER_S)


def make_header(factory: MessageFactory, ns: int, frame_id: str = "") -> Any:
    """A std_msgs/Header."""
    sec, nanosec = stamp_fields(ns)
    stamp = factory.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return factory.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)
