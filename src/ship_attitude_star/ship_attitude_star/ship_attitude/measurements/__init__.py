"""Kinds of measurement of the ship filter; each is a device class with ``linearise`` in ``devices``.

``kind`` holds the base class. ``prediction`` holds what all kinds share: predicted attitude and iterated linearisation.
"""
