"""The calibration filter: its states, what they predict of a sighting, whether it may be used, the next state."""
