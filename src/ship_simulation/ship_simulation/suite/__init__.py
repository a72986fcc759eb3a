"""The suite file that belongs to a scenario: the parameters that the nodes would be given on that ship.

The room writes names and values alone. It imports ``scenario/``, and no node's configuration.
"""
