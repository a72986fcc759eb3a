"""Fit of the axis errors to sightings of known directions: robust, with what they cannot tell apart."""
