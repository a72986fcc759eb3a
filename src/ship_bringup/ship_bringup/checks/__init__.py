"""Checks before a voyage, one module each, which separates reading the state of the machine from evaluating it.

The room may import ``suite/``, ``security/`` and the checks of suite files (``ship_replay.preflight``). Nothing in it
changes anything on the machine.
"""
