"""Sightings of known directions from a bag, and the fit of axis errors to them: ``axis_sightings``, ``fit_axes``.

The folder holds tables of sightings, the robust fit of the exact axis geometry, the diagnostics of a fit, and its
figures and tables. It imports no other folder of the package.
"""
