"""Fault detection and exclusion, from ``subfilters`` and ``isolation`` to the ``exclusion`` of a source.

``common_error`` is the error that all stars share.
"""
