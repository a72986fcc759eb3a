"""Many runs at once: bags or scenarios, parameter sets and seeds, made by worker processes here or by a Dask cluster.

What is to be made is a list of items, each with a key by all that its result depends on; results are files by that key.
The room imports ``offline/``, ``evaluation/`` and ``report/``, and the simulation.
"""
