"""The ship's true motion and track, and the devices aboard that tell an attitude or a place.

The room knows no stars and no theodolite. It imports ``draws/`` and ``scenario/``.
"""
