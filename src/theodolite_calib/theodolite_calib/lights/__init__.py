"""Lights on the detector: image, lines of sight, the telescope's attitude, and which light is which."""
