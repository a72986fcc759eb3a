"""Apparent star directions for a ship: star catalogue, ship's position, air, and the errors that all directions share.

The folder may import ``measurements``. It holds the parameters that both nodes share (``config``, ``masks``).
It does not import cameras or estimators, so that the simulation may import it too.
"""
