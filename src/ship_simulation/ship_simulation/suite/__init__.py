"""The suite file of a scenario: the parameters of the nodes for that ship.

The folder writes names and values only. It imports ``scenario/``, ``ship/deflection.py`` and the common schemas of
devices (:mod:`ship_estimation.parameters`, the camera of ``ship_stars``), but no configuration of a node.
"""
