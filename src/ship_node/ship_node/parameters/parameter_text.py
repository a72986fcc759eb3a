"""A configuration as the text of a ROS 2 parameter file."""

from collections.abc import Mapping
from typing import Any

import yaml

from ship_estimation.parameters import flatten, nest
from ship_node.parameters.parameter_file import anywhere
from ship_node.parameters.parameter_yaml import PARAMETERS_KEY


class _Dumper(yaml.SafeDumper):
    """Texts always in quotes: what looks like a text to YAML may be a number to ROS."""


_Dumper.add_representer(str, lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style='"'))


def parameter_text(node_name: str, config: Any) -> str:
    """A parameter file that gives a node this very configuration, in whatever namespace, all defaults written out.

    Args:
        node_name: name without namespace.
        config: a dataclass in the style of :mod:`ship_estimation.parameters`.
    """
    return _text({anywhere(node_name): nest(flatten(config))})


def sections_text(nodes: Mapping[str, Mapping[str, Any]]) -> str:
    """A parameter file for several nodes.

    Args:
        nodes: full name → dotted name of a parameter → value.
    """
    return _text({name: dict(nodes[name]) for name in sorted(nodes)})


def _text(sections: dict[str, Any]) -> str:
    document = {name: {PARAMETERS_KEY: values} for name, values in sections.items()}
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1_000_000)
