"""The study before the voyage: how well lights on drones will tell where the theodolite points, and what that rests on.

The accuracies are those of ``escort``: the calibration filter's own model. The room imports ``escort``, ``filter``,
``config`` and below, and what writes files.
"""
