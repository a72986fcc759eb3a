"""Parameters of a node: the sections of a parameter file that are for it, checked, and listed for ``--help``.

How such files are read and written is known by :mod:`ship_bags.parameter_yaml`. Of the package the room imports only
the edge; ROS is unknown here.
"""
