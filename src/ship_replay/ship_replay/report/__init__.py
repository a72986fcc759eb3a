"""One-page reports: events of a run with the sources that caused them.

States, and alerts that are not recorded in the bag, are computed by :mod:`ship_watch`, as on the live page. All
statistics are computed by ``evaluation/``; only the test of stated sigmas over a whole run is computed here.
"""
