"""Calibration filter: its states, the prediction of a sighting, gate, update, fault detection and observability.

``step`` processes beacons, ``star_step`` stars. ``sighting_gate`` checks the beacons' names with the telescope's
attitude from their image (``telescope_attitude``). Nothing here handles time order or late samples. The folder may
import ``samples`` and ``config``.
"""
