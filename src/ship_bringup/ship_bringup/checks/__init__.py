"""Checks before a voyage; a state of the machine is first read and then evaluated.

The folder may import ``suite/``, ``security/`` and the checks of suite files (``ship_replay.preflight``). No check
changes anything on the machine.
"""
