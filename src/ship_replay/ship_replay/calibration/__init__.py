"""Installation calibration: a session (a bag) becomes installation angles with their covariance.

One session walks one way: bag → :mod:`session` (the suite's own nodes) → :mod:`observability` (which combinations of
the angles it could tell) → :mod:`result` → :mod:`tables`, :mod:`figure`, :mod:`words`, and the alignment file that
``ship_attitude`` starts from.
"""
