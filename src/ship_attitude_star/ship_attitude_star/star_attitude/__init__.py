"""Core of the node ``star_attitude``: attitudes of sensors and deck from exposures of star sensors.

The folder may import ``plausibility`` and :mod:`ship_stars`, but not the core of ``ship_attitude``.
"""
