"""One-page reports: what happened when, because of which source, and how two runs differ.

The bag is read once through :mod:`ship_watch`, so the page states the same as the live page and the alerts. All
statistics are computed by ``evaluation/``; only the test of stated sigmas over a whole run is computed here.
"""
