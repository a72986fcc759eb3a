"""The suite file of a scenario: the parameters of the nodes for that ship.

The folder writes names and values only. It imports ``scenario/``, ``ship/deflection.py`` and names of parameter values
from the packages of the nodes, but no class of a node's configuration.
"""
