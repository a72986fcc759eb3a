"""Parameters of a node: parameter files, and the ports, devices and files that a node's parameters occupy.

Parameter files are read and written by :mod:`ship_bags.parameter_yaml`. The folder imports no other folder of this
package and no ROS.
"""
