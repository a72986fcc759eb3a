"""Fault detection of the ship filter, exclusion and reinstatement of its sources, and faults of the INS."""
