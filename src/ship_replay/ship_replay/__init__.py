"""The suite offline: bags and black boxes replayed, runs evaluated and smoothed, configurations checked.

The package imports the adapters of all nodes. Only ``ship_studies``, ``ship_monitor``, ``ship_nmea`` and
``ship_bringup`` may import the package. Each folder may import the folders after it in this list: ``commands/``
(command lines), ``comparison/`` (page of two runs), ``report/`` (page of one), ``evaluation/``, ``preflight/`` and
``verification/`` (results of a run), ``offline/`` (replay).
"""
