"""The checks before a voyage, one module each: what was found there, and apart from it what to think of that.

The room may import ``suite/``, ``security/`` and the checks of suite files (``ship_replay.preflight``). Nothing in it
changes anything on the machine.
"""
