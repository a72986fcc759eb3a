"""Adapters of the nodes: which topic feeds which method of a core (sensors: ``messages``), and the alignment file."""
