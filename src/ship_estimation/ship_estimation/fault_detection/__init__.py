"""Fault detection and exclusion: subfilters, windowed innovation means, isolation, unconfirmed steps."""
