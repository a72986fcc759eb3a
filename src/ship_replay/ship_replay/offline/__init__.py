"""A bag through the suite's nodes, in process: the chain of adapters, its outputs, black boxes, comparison to the bit.

The folder imports the nodes' adapters and configurations, and no other folder of the package.
"""
