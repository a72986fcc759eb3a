"""Measured samples: checked on reception, kept in tracks, and assembled to sightings.

A sighting is one exposure of beacons, or of stars, with all samples at the middle of the exposure that it is compared
with. The folder may import ``config``, ``lights`` and ``chain``, and the stars of ``ship_attitude_star``.
"""
