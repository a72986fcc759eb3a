"""Evaluation of a run: errors against the truth, innovations and estimates, as tables and figures, with bounds.

The folder reads published outputs. Of this package it imports only ``offline/``.
"""
