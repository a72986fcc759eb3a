"""Position of a target from the directions of several theodolites: the node's core."""
