"""Adapters, messages in and out, diagnosis, files and nodes.

The room may import all others; only nodes and ``ship_replay`` import it.
"""
