"""Identification of an INS's error model from a bag with stars by maximum likelihood.

Data flow from the bag:

1. :mod:`session`: comparison of each star measurement with the INS by the suite's own node.
2. :mod:`star_record`: record of these comparisons, with one information matrix for each epoch.
3. :mod:`likelihood`: likelihood of the record for a process of :mod:`processes`.
4. :mod:`fit`: parameters of the process with their covariance; correlation times by :mod:`correlation_time`.
5. :mod:`outage`: predictions of the fitted model without stars.
6. :mod:`identification`: model selection and warnings.
7. :mod:`parameter_output`: parameter file and text of the result.

Of ``ship_replay`` the folder imports only ``offline/``.
"""
