"""The core of the node ``star_attitude``: exposures of star sensors in, attitudes of sensors and deck out."""
