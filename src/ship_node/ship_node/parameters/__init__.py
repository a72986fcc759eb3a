"""Parameters of a node: reading and checking of a parameter file, and the list for ``--help``.

Parameter files are read and written by :mod:`ship_bags.parameter_yaml`. From this package the folder imports only
:mod:`~ship_node.adapters` and :mod:`~ship_node.messages`; the folder does not import ROS.
"""
