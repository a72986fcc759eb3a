"""Identification of an INS's error model from a bag with stars by maximum likelihood.

Data flow from the bag:

1. :mod:`session`: the suite's own node compares each star measurement with the INS.
2. :mod:`star_record`: these comparisons, condensed.
3. :mod:`likelihood` of a process of :mod:`processes`.
4. :mod:`fit`: the parameters of the process with their covariance, times by :mod:`correlation_time`.
5. :mod:`outage`: predictions of the fitted model without stars.
6. :mod:`identification`: model selection, warnings.
7. :mod:`parameter_output`: the parameter file, the text.

The folder imports only ``offline/``.
"""
