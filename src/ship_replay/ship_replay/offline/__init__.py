"""Replay of a bag through the suite's nodes in one process: adapter chain, outputs, smoothing.

The folder imports the nodes' adapters and configurations, but no other folder of the package.
"""
