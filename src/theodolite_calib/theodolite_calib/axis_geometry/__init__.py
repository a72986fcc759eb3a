"""Axis geometry of the theodolite: main axis and telescope from the ship's attitude and the encoders, and the inverse.

The room holds exact geometry without any configuration, so that the simulation can use it too. It imports
``ship_geometry`` alone.
"""
