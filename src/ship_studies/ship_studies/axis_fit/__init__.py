"""Fit of axis errors to sightings of known directions, and the executable ``fit_axes``.

The folder holds tables of sightings, the robust fit of the exact axis geometry, the diagnostics of a fit, and its
figures and tables. It may import every other folder of the package; no other folder imports it.
"""
