"""What is measured: samples, watched as they come, kept in tracks, and put together to sightings.

A sighting is one exposure of lights, or of stars, with all that it is compared with, at the middle of the exposure. The
room may import ``config``, ``lights`` and ``chain``, and the stars of ``ship_attitude_star``.
"""
