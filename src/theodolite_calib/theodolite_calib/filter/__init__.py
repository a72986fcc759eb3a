"""The calibration filter: its states, what they predict of a sighting, which sightings are used, and what stays open.

Nothing here knows of time order or of samples that arrive late. The room may import ``measured`` and the rooms below.
"""
