"""A configuration as the text of a ROS 2 parameter file."""

from typing import Any

from ship_bags.parameter_yaml import anywhere, sections_text
from ship_estimation.parameters import flatten, nest


def parameter_text(node_name: str, config: Any) -> str:
    """A parameter file that gives a node this very configuration, in whatever namespace, all defaults written out.

    Args:
        node_name: name without namespace.
        config: a dataclass in the style of :mod:`ship_estimation.parameters`.
    """
    return sections_text({anywhere(node_name): nest(flatten(config))})
