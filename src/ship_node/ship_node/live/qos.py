"""Quality of service of inputs and outputs, and what of it a parameter file may override."""

import contextlib
import warnings
from collections.abc import Iterator

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from ship_bags.errors import BadInput
from ship_node.edge.topics import InputTopic, OutputTopic

OUTPUT_DEPTH = 2000
"""Messages kept for readers that acknowledge late: two seconds of data at 1 kHz, or a cut of 20 s at 100 Hz."""

RELIABLE_DEPTH = 2000
"""Messages of a reliable input that may come in one go when the link is there again after a cut."""

_OVERRIDABLE = QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH
_EXPECTED = (
    "reliability: reliable | best_effort, durability: volatile | transient_local, history: keep_last | keep_all, "
    "depth: an integer from 1"
)


def input_qos(input_topic: InputTopic, is_reliable: bool) -> QoSProfile:
    """Best effort, so that a lost message never holds up the newer ones; deep enough for a second of data.

    Args:
        input_topic: the topic.
        is_reliable: whether what was lost on the way is sent again instead, also after a cut of the link.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(input_topic.depth, RELIABLE_DEPTH) if is_reliable else input_topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )


def output_qos(output_topic: OutputTopic) -> QoSProfile:
    """Reliable; a latched topic keeps its last message for those who come later."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1 if output_topic.latched else OUTPUT_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if output_topic.latched else DurabilityPolicy.VOLATILE,
    )


def overridable() -> QoSOverridingOptions:
    """``qos_overrides./TOPIC.subscription.reliability`` (or ``publisher``) and the like are parameters."""
    return QoSOverridingOptions(_OVERRIDABLE, callback=_check_depth)


@contextlib.contextmanager
def overrides_checked(node: Node, topic: str) -> Iterator[None]:
    """Creating the publisher or subscription of a topic inside this reports overrides that cannot be used.

    Raises:
        BadInput: names the topic and what was expected.
    """
    try:
        with warnings.catch_warnings():
            # rclpy warns of a depth of 0, which is refused here.
            warnings.simplefilter("ignore")
            yield
    except (RuntimeError, InvalidQosOverridesError, ParameterException) as error:
        name = f"qos_overrides.{node.resolve_topic_name(topic)}"
        raise BadInput(f"parameter '{name}': {error}; expected {_EXPECTED}", parameters=(name,)) from error


def _check_depth(profile: QoSProfile) -> SetParametersResult:
    return SetParametersResult(successful=profile.depth > 0, reason="depth must be at least 1")
