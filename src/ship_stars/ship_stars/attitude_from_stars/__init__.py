"""Attitude from the stars of an exposure.

``exposure`` and ``identification`` give the catalogue star of each detection, and ``selection`` the correctly
identified stars. ``attitude_fit`` computes the attitude (Wahba's problem), and ``solution`` its covariance and status.
``residuals`` compares the stars with a predicted attitude instead, as measurements of a filter. ``field_scale`` checks
the focal length.
"""
