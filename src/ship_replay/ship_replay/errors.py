"""The package's exception for bad input: that of the nodes, so that both are said alike."""

from ship_node.errors import BadInput as BadInput
