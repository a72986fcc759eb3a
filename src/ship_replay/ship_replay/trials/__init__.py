"""Series of runs: Monte Carlo, voyages with faults, nodes as processes, and data left on the disk after a kill.

The folder serves tests and tools. Of the other folders of ``ship_replay``, it imports only ``offline/`` and
``evaluation/``. Only this folder and ``campaign/`` import the simulation.
"""
