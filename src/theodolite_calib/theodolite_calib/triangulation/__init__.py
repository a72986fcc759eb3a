"""The command ``triangulate``: what several theodolites recorded of a target, and the places that follow from it.

Knows bags, the reader of directions (``ros``) and the room ``target``, no filter and no node.
"""
