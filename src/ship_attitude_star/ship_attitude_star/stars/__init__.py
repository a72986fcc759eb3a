"""From an exposure to an attitude: camera, exposure with identities and places, choice of stars, fit and solution.

The room may import the measurements and the sky. Of parameters it holds those that both nodes share (``config``). It
knows nothing of the cores, so that the simulation may import its camera too.
"""
