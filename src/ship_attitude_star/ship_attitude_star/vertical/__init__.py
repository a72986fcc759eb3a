"""Deflection of the vertical along the ship's track, and the distance run since a measurement.

The folder imports the ship position (``sky``) and ``measurements``, but neither ``stars`` nor the filter.
"""
