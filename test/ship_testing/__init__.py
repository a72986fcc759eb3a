"""Helpers for tests of several packages: scenes, voyages, hand-made bags, adapter runs, peer nodes."""
