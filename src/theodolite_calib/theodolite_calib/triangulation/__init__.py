"""Command ``triangulate``: positions of a target from recorded directions of several theodolites.

The folder uses bags, the reader of directions (``ros``) and the folder ``target``, but no filter and no node.
"""
