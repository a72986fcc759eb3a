"""Calibration filter: its states, the prediction of a sighting, gate, update, fault detection and observability.

Nothing here handles time order or late samples. The folder may import ``samples`` and the folders below.
"""
