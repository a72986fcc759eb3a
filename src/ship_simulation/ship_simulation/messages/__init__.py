"""Simulated arrays as messages in the order of their arrival.

The folder imports all other folders, but not ``suite_file``.
"""
