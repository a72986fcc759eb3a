"""The core of the node ``optical_axis``: encoders, ship, baselines and lights in, the main axis out."""
