"""Campaigns: bags or scenarios, parameter sets and seeds, run by worker processes here or by a Dask cluster.

A campaign is a list of items. The key of an item is derived from everything that its result depends on, and names the
file of this result. The folder imports ``offline/``, ``evaluation/`` and ``report/`` of ``ship_replay``, and the
simulation.
"""
