"""Many runs for one statement: Monte Carlo, voyages with faults, nodes as processes, and data on disk after a kill.

The room serves tests and tools. Of this package it imports ``offline/`` and ``evaluation/``; only it and ``campaign/``
import the simulation.
"""
