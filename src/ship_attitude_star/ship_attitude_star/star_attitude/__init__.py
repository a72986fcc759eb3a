"""The core of the node ``star_attitude``: exposures of star sensors in, attitudes of sensors and deck out.

The room may import measurements, sky, stars and guards. It does not import the core of ``ship_attitude``.
"""
