"""Apparent star directions for a ship: star catalogue, ship's position, air, and the errors that all directions share.

The folder may import ``attitude_samples``. ``config`` and ``deck_masks`` have the parameters that ``ship_attitude`` and
``star_attitude`` share. The folder does not import cameras or estimators, so the simulation can import it too.
"""
