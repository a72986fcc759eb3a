"""Measurements and outputs that several cores share, as data classes in radians, metres and nanoseconds."""
