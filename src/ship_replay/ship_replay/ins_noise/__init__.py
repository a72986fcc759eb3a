"""Identification of an INS's error model from a bag with stars by maximum likelihood.

Data flow: bag → :mod:`session` (the suite's own node, which compares each star measurement with the INS) →
:mod:`star_record` (these comparisons, condensed) → :mod:`likelihood` of a process of :mod:`processes` → :mod:`fit` (its
parameters with their covariance, times by :mod:`correlation_time`) → :mod:`outage` (predictions of the fitted model
without stars) → :mod:`identification` (model selection, warnings) → :mod:`parameter_output` (the parameter file, the
text).

The room imports only ``offline/``.
"""
