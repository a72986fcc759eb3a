"""The suite file that belongs to a scenario: the parameters that the nodes would be given on that ship.

The room writes names and values alone. It imports ``scenario/`` and the names of the axis errors
(``theodolite_calib.chain``), and no node's configuration.
"""
