"""Position of a target from the directions of several theodolites.

``triangulation`` has the parameters and pure functions; ``triangulation_core`` is the core of the node.
"""
