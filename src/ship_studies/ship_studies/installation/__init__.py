"""Installation angles of star sensors from a bag.

Data flow: bag → ``session`` (the suite's own nodes) → ``result`` (installation angles, their covariance, and the
observability of their combinations) → ``tables``, ``figure``, and the alignment file that ``ship_attitude`` loads. Of
``ship_replay`` the folder imports only ``offline/``.
"""
