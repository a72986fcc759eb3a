"""Advised positions of the drones: best pointing within limits, and the accuracy there.

The folder uses the model of the calibration filter and has no error model of its own. It imports ``filter``,
``measured``, ``lights``, ``config`` and below.
"""
