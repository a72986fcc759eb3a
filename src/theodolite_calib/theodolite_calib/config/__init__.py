"""Parameters of the node ``optical_axis``, with units and ranges."""
