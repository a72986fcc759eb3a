"""The suite file of a scenario: the parameters of the nodes for that ship.

The room writes names and values only. It imports ``scenario/`` and the names of the axis errors
(``theodolite_calib.axis_geometry``), and no node's configuration.
"""
