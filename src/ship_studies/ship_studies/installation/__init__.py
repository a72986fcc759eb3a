"""Installation angles of star sensors from a bag.

Data flow: bag → ``session`` (the suite's own nodes) → ``result`` (installation angles, their covariance, and the
observability of their combinations) → ``calibrate_installation_command`` (tables, JSON, and the alignment file that
``ship_attitude`` loads) and ``figure``. Of ``ship_replay`` the folder imports only ``offline/``.
"""
