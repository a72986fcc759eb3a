"""From pixels to an attitude: camera, fit, selection, solution, identification.

The room may import the sky and the measurements.
"""
