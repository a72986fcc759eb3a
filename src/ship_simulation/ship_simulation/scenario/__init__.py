"""Scenario files, read and checked, as frozen dataclasses, and the names that follow from them.

The folder draws no random numbers and imports no other folder. Of the nodes it imports the parameters of a star camera
(``ship_attitude_star.stars.config``).
"""
