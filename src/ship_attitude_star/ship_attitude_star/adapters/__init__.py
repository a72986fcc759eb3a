"""Adapters of the nodes: which topic feeds which method of a core, and the alignment file."""
