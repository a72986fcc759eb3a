"""Many runs for one claim: Monte Carlo, voyages with faults, nodes as processes, and what a kill leaves on the disk.

The room serves tests and tools. Of this package it imports ``offline/`` and ``evaluation/``; it and ``campaign/`` alone
know the simulation.
"""
