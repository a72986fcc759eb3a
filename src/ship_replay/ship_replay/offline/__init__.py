"""Replay of a bag through the suite's nodes in one process: adapter chain, outputs, black boxes, bitwise comparison.

The folder imports the nodes' adapters and configurations, but no other folder of the package.
"""
