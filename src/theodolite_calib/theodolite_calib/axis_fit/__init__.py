"""The fit of axis errors to sightings of known directions, and the executable that does it.

The room knows tables of sightings, the robust fit of the exact chain of axes, what speaks against a fit, and how to
show it. It may import every other room of the package; no other room imports it.
"""
