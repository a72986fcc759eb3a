"""Calibration from a bag: installation angles of star sensors, and sightings for the fit of a theodolite's axes.

Data flow: bag → :mod:`session` (the suite's own nodes) → :mod:`result` (installation angles with their covariance, and
which combinations of them were observable) → :mod:`tables`, :mod:`figure`, and the alignment file that
``ship_attitude`` loads. The room imports only ``offline/``.
"""
