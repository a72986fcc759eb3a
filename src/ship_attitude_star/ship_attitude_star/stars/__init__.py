"""Attitude from an exposure: camera, identification, star positions, selection of stars, fit and solution.

The folder may import ``measurements`` and ``sky``. ``config`` has the parameters that ``ship_attitude`` and
``star_attitude`` share. The folder does not import the cores of the nodes, so the simulation can import the camera
without the cores.
"""
