"""Advised positions of the drones: best pointing within limits, and the accuracy there.

The folder uses the error model of the calibration filter. It imports ``filter``, ``measured``, ``lights``, ``config``
and folders below them.
"""
