"""Vertical along the track: deflection of the vertical at the ship's position, and distance run.

The folder imports the ship position (``sky``) and ``measurements``, but neither stars nor the filter.
"""
