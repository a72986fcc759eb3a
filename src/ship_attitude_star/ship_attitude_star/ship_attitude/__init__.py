"""The core of the node ``ship_attitude``: INS and stars in, the ship's attitude with its error budget out."""
