"""Where stars are seen from the ship: the catalogue, her place, the air, apparent directions and their shared errors.

The room may import the measurements. It knows nothing of cameras, estimators and the parameters of nodes, so that the
simulation may import it too.
"""
