"""A run told in one page: what happened when, by which source, and how two runs differ.

The room reads a bag once through :mod:`ship_watch`, so that it says the same as the live page and the alerts, and takes
all statistics from ``evaluation/``. It judges nothing of its own but whether stated sigmas fit over a whole run.
"""
