"""Plausibility checks of the inputs, and diagnosis hints for a lasting disagreement between a source and the INS.

The folder applies the checks of :mod:`ship_estimation` to all input streams. It imports no
other folder of this package; measurements are from :mod:`ship_stars.samples`.
"""
