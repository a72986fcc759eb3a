"""Displays of a suite, live or recorded: page and terminal view; and the alert node.

The state of the suite is computed in :mod:`ship_watch`; this package reads topics or bags and draws the state.
"""
