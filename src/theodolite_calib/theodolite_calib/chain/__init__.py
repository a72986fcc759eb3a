"""Axes of the theodolite: from the ship's attitude and the encoders to the main axis in the horizon, exact."""
