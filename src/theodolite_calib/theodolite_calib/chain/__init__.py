"""The axes of the theodolite: from the ship's attitude and the encoders to the main axis and the telescope, and back.

The room holds exact geometry without any configuration, so that the simulation can build on it too. It imports
``ship_geometry`` alone.
"""
