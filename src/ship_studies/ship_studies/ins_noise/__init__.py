"""Identification of an INS's error model from a bag with stars by maximum likelihood.

Data flow from the bag:

1. :mod:`session`: comparison of each star measurement with the INS by the suite's own node.
2. :mod:`star_record`: record of these comparisons, with one information matrix for each epoch, and its likelihood for a
   process of :mod:`processes`.
3. :mod:`fit`: parameters of the process with their covariance, and predictions of the fitted model without stars.
4. :mod:`identify_noise_command`: model selection, warnings, parameter file and text of the result.

Of ``ship_replay`` the folder imports only ``offline/``.
"""
