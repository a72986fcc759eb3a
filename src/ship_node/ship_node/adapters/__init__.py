"""Adapters: the way of a message from a topic through a core to the outputs of a node."""
