"""Fault detection and exclusion of the ship filter: its table of sources, special cases of the INS, integrity."""
