"""Evaluation of a run: errors against the truth, innovations and estimates, with tables, figures and bounds.

The folder reads published outputs. Of this package it imports only ``offline/``.
"""
