"""Command ``triangulate``: recorded directions of several theodolites to a target, and the positions that follow.

It uses bags, the reader of directions (``ros``) and the folder ``target``, but no filter and no node.
"""
