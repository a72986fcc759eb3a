"""Measurements of the ship's attitude alone, as plain data classes."""
