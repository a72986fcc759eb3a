"""Command ``triangulate``: positions of a target from recorded directions of several theodolites."""
