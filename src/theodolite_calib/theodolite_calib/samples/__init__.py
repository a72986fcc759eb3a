"""Measured samples: checked on reception, kept in tracks, and assembled to sightings.

A sighting is one exposure, of beacons or of stars, with all samples for its comparison at the middle of the exposure.
The folder may import ``config``, and star exposures from ``ship_stars``.
"""
