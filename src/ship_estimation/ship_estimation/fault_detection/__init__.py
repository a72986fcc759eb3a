"""Fault detection and exclusion: subfilters, innovation means, isolation, detector, errors common to all stars."""
