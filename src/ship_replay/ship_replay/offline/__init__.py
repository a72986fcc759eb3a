"""A bag through the suite's nodes, in process: the chain of adapters, its outputs, black boxes, comparison to the bit.

The room knows the adapters' shell and the nodes' configurations. It imports no other room.
"""
