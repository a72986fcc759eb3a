"""Where stars are seen from the ship: the catalogue, her place, the air, apparent directions and their shared errors.

The room may import the measurements. Of parameters it holds those that both nodes share (``config``, ``masks``).
It knows nothing of cameras and estimators, so that the simulation may import it too.
"""
