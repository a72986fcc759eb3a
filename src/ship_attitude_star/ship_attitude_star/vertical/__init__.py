"""Deflection of the vertical along the ship's track, and the distance run since a measurement.

The folder imports the ship's position and data classes of inputs from :mod:`ship_stars`, but neither camera, star
solution nor the filter.
"""
