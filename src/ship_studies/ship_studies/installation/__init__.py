"""Calibration from a bag: installation angles of star sensors, and sightings for the fit of a theodolite's axes.

Data flow: bag → ``session`` (the suite's own nodes) → ``result`` (installation angles, their covariance, and the
observability of their combinations) → ``tables``, ``figure``, and the alignment file that ``ship_attitude`` loads. Of
this package the folder imports only ``offline/``.
"""
