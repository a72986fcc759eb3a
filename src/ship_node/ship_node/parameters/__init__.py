"""Parameters of a node: its sections of a parameter file, checked, and listed for ``--help``.

Such files are read and written by :mod:`ship_bags.parameter_yaml`. Of the package the folder imports only
:mod:`~ship_node.edge`, and no ROS.
"""
