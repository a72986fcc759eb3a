"""Adapter, messages in and out, diagnosis, files and node.

The room may import all others; only the node and ``ship_replay`` import it.
"""
