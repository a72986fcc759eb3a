"""The suite file of a scenario: the parameters of the nodes for that ship.

The folder writes names and values only. It imports ``scenario/`` and the names of the axis errors
(``theodolite_calib.chain``), and no node's configuration.
"""
