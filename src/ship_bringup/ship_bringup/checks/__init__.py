"""Checks before a voyage, one module each; reading the state of the machine is separate from evaluating it.

The folder may import ``suite/``, ``security/`` and the checks of suite files (``ship_replay.preflight``). Nothing in it
changes anything on the machine.
"""
