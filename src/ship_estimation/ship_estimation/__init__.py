"""Estimation without ROS: Kalman steps on a budget of sources, gates, time-ordered estimator shell, consistency.

Guards judge what an estimator may use before it compares anything: :mod:`ship_estimation.ins_guard` the samples of an
INS, :mod:`ship_estimation.rate_guard` its rates, :mod:`ship_estimation.value_guards` values that stand still or jump.

What later measurements tell of earlier states goes back step by step (:mod:`ship_estimation.backward`) along a chain of
them (:mod:`ship_estimation.backward_chain`).

Verdicts (:mod:`ship_estimation.verdicts`) tell by the innovations of a source whether it is as it states.

Names, frames and units: :mod:`ship_geometry`. State vectors hold errors of named parts
(:mod:`ship_estimation.kalman`); a covariance is a stack of parts, one per source of error, whose sum is the
covariance (:mod:`ship_estimation.kalman`).
"""
