"""Estimation without ROS: Kalman steps on a budget of sources, gates, time-ordered estimator shell, consistency.

Names, frames and units: :mod:`ship_geometry`. State vectors hold errors of named parts
(:mod:`ship_estimation.kalman`); a covariance is a stack of parts, one per source of error, whose sum is the
covariance (:mod:`ship_estimation.kalman`).
"""
