"""How the error of an INS goes on, found from a bag with stars by maximum likelihood.

One record walks one way: bag → :mod:`session` (the suite's own node, which compares each star measurement with the
INS) → :mod:`star_record` (these comparisons, condensed) → :mod:`likelihood` of a process of :mod:`processes` →
:mod:`fit` (its parameters with their covariance, times by :mod:`correlation_time`) → :mod:`outage` (what the fitted
model is worth without stars) → :mod:`identification` (which model fits, what must be warned of) → :mod:`written` (the
parameter file, the text).
The room imports ``offline/`` alone.
"""
