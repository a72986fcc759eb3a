"""Scenario files, read and checked, as frozen dataclasses, and the names that follow from them.

The folder draws no random numbers and imports no other folder. It imports the parameters of star cameras and masks
from :mod:`ship_stars`, those of devices and INS errors from :mod:`ship_estimation.parameters`.
"""
