"""Random parts of a voyage: streams of numbers, correlated errors, the sea.

All numbers depend only on the seed. The folder imports only ``scenario/``.
"""
