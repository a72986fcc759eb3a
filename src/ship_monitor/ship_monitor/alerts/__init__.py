"""Node that raises alerts and accepts acknowledgements.

The alerts are stored in this node and in a file, not in the displays. `alert_manager` uses no ROS; `alert_node`
connects the manager to the network. The folder imports no other folder of this package than live.
"""
