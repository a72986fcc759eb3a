"""Advised positions of the drones: best pointing within limits, and the accuracy at these positions.

The folder uses the error model of the calibration filter. The folder imports ``filter``, ``samples`` and
``config``.
"""
