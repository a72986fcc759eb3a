"""One-page reports: events of a run with the sources that caused them, and differences between two runs.

The bag is read once through :mod:`ship_watch`, so that states and alerts are those of the live page. All statistics
are computed by ``evaluation/``; only the test of stated sigmas over a whole run is computed here.
"""
