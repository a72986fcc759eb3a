"""Trials in numbers: Monte Carlo runs of the cores, and processes killed at random moments."""
