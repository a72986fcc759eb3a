"""Simulated arrays as messages in the order of their arrival.

The room imports all other rooms but ``suite/``.
"""
