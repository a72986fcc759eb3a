"""Scenario files, read and checked, as frozen dataclasses, and the names that follow from them.

The room draws nothing and imports no other room. Of the nodes it imports the parameters of a star camera
(``ship_attitude_star.stars.config``).
"""
