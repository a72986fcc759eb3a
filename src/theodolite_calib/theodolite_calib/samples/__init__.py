"""Measured samples: checked on reception, kept in tracks, and assembled to sightings.

A sighting is one exposure, of beacons or of stars, with all samples for its comparison at the middle of the exposure.
The folder may import ``config`` and ``lights``, and the stars of ``ship_attitude_star``.
"""
