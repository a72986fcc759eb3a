"""The node that raises alerts and takes acknowledgements.

Alerts live here and in a file, not in what shows them. `alert_keeper` knows no ROS; `alert_node` puts it on the
network. The room imports ship_watch and the room live, and no other room.
"""
