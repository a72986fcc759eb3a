"""Trials of the whole suite: voyages with faults, hours without faults, live runs, kill trials, Monte Carlo."""
