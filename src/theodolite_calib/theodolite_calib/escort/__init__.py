"""Where the drones should fly: places with the best pointing within limits, and the accuracy that they bring.

The room asks the model of the calibration filter what lights at a place are worth, and has no error model of its own.
It imports ``filter``, ``measured``, ``lights``, ``config`` and below.
"""
