"""Refraction of light by the air."""
