"""Axis geometry of the theodolite: main axis and telescope from the ship's attitude and the encoders, and the inverse.

This is the mount model with all axis errors (:class:`.axes.AxisErrors`). The folder has no configuration, so that the
simulation can use the folder too. The folder imports only ``ship_geometry`` of the suite.
"""
