"""Campaigns: bags or scenarios, parameter sets and seeds, run by worker processes here or by a Dask cluster.

A campaign is a list of items, each with a key derived from everything its result depends on; results are files named by
that key. The folder imports ``offline/``, ``evaluation/`` and ``report/``, and the simulation.
"""
