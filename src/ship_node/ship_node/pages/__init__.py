"""Figures and HTML pages of studies."""
