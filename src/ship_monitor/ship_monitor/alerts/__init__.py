"""Node that raises alerts and accepts acknowledgements.

Alerts are stored here and in a file, not in the displays. `alert_manager` uses no ROS; `alert_node` connects it to the
network. The folder imports ship_watch and the folder live only.
"""
