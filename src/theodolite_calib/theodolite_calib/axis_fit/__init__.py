"""Fit of axis errors to sightings of known directions, and its executable.

Contains tables of sightings, the robust fit of the exact axis geometry, the diagnostics of a fit, and its figures and
tables. No other folder of the package imports it.
"""
