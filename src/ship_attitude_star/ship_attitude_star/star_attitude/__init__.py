"""Core of the node ``star_attitude``: attitudes of sensors and deck from exposures of star sensors.

The folder does not import the core of ``ship_attitude``.
"""
