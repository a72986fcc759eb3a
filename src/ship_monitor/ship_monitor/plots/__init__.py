"""Plots of the live page: panels, lines, figures and the map of the sky."""
