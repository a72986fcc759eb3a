"""From an exposure to an attitude: camera, exposure with identities and places, choice of stars, fit and solution.

The room may import the measurements and the sky. It knows nothing of the cores and of the parameters of nodes, so that
the simulation may import its camera too.
"""
