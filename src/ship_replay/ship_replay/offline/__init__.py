"""A bag through the suite's nodes, in process: the chain of adapters, its outputs, black boxes, comparison to the bit.

The room uses the adapters and the configurations of the nodes. It imports no other room.
"""
