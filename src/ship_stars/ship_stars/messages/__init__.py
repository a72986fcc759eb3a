"""Readers of the messages of star sensors and of the surroundings: position fixes and air."""
