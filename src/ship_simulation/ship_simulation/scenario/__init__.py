"""Scenario files, read and checked, as frozen dataclasses, and the names that follow from them.

The folder draws no random numbers and imports no other folder. From the packages of the nodes it imports the parameters
of star cameras, masks and INS errors (``ship_attitude_star``).
"""
