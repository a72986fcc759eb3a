"""From an exposure to an attitude: camera, identification, star positions, selection of stars, fit and solution.

The folder may import ``measurements`` and ``sky``. It holds the parameters that both nodes share (``config``). It does
not import the cores, so that the simulation may import its camera too.
"""
