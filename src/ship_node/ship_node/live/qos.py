"""Quality of service of inputs and outputs, and the policies that a parameter file may override."""

import contextlib
import warnings
from collections.abc import Iterator

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from ship_bags.errors import BadInput
from ship_node.messages.topics import InputTopic, OutputTopic

OUTPUT_DEPTH = 2000
"""Number of messages kept for late acknowledgements, enough for two seconds at 1 kHz or 20 s at 100 Hz."""

RELIABLE_DEPTH = 2000
"""Number of messages of a reliable input that may arrive at once after an outage of the link."""

_OVERRIDABLE = QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH
_EXPECTED = (
    "reliability: reliable | best_effort, durability: volatile | transient_local, history: keep_last | keep_all, "
    "depth: an integer from 1"
)


def input_qos(input_topic: InputTopic, is_reliable: bool) -> QoSProfile:
    """Return the QoS of an input: best effort by default, so that a lost message never delays newer messages.

    Args:
        input_topic: the topic, with a depth of one second of data.
        is_reliable: True if lost messages must be sent again, even after an outage of the link.
    """
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(input_topic.depth, RELIABLE_DEPTH) if is_reliable else input_topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.VOLATILE,
    )


def output_qos(output_topic: OutputTopic) -> QoSProfile:
    """Return the QoS of an output: reliable; a latched topic keeps its last message for late subscribers."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1 if output_topic.latched else OUTPUT_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if output_topic.latched else DurabilityPolicy.VOLATILE,
    )


def overriding_options() -> QoSOverridingOptions:
    """Return the options that declare parameters such as ``qos_overrides./TOPIC.subscription.reliability``."""
    return QoSOverridingOptions(_OVERRIDABLE, callback=_check_depth)


@contextlib.contextmanager
def check_overrides(node: Node, topic: str) -> Iterator[None]:
    """Report unusable overrides while the publisher or subscription of a topic is created in this context.

    Raises:
        BadInput: an override cannot be used; the text names the parameter and what is expected.
    """
    try:
        with warnings.catch_warnings():
            # rclpy only warns of a depth of 0, which is refused here.
            warnings.simplefilter("ignore")
            yield
    except (RuntimeError, InvalidQosOverridesError, ParameterException) as error:
        name = f"qos_overrides.{node.resolve_topic_name(topic)}"
        raise BadInput(f"parameter '{name}': {error}; expected {_EXPECTED}", parameters=(name,)) from error


def _check_depth(profile: QoSProfile) -> SetParametersResult:
    return SetParametersResult(successful=profile.depth > 0, reason="depth must be at least 1")
