"""Faults between a device and the suite: missing, late and wrong messages, as a scenario or a file describes them.

The folder changes messages that others created, from a simulation or from a bag. It imports ``scenario/``, the random
streams of ``draws/``, cameras and the star catalogue.
"""
