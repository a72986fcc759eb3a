"""Faults between a device and the suite: missing, late and wrong messages, described in a scenario or a file.

The folder changes existing messages, from a simulation or from a bag. It imports ``scenario/``, the random streams of
``random_draws``, cameras and the star catalogue.
"""
