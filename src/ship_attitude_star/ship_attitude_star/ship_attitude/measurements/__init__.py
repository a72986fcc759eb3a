"""Kinds of measurement of the ship filter: a device class with ``linearise`` each, in ``devices`` or in its own file.

``device`` holds the base class, and lists the parts of a new kind of sensor. ``prediction`` holds what all kinds share:
predicted attitude and iterated linearisation.
"""
