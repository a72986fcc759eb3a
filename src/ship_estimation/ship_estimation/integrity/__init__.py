"""Integrity: protection levels of outputs, and their coverage of later outputs."""
