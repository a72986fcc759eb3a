"""Attitude from an exposure: identification, selection of stars, fit and solution."""
