"""Series of runs: Monte Carlo, voyages with faults, nodes as processes, and data left on the disk after a kill.

The folder serves tests and tools. Of this package it imports ``offline/`` and ``evaluation/``. Only this folder and
``campaign/`` import the simulation.
"""
