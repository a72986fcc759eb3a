"""Many runs for one claim: Monte Carlo through the cores, nodes as processes, and what a kill leaves on the disk.

The room serves tests and tools. It imports ``offline/`` alone.
"""
