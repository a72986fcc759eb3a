"""The way back after a fault: a second estimator runs beside the first one in trouble, and replaces it if it is right.

- ``trouble`` detects that the status of an estimator is worse than its inputs allow.
- ``memory`` keeps the last undisputed state.
- ``displacement`` and ``displacements`` measure whether a source, or all together, have moved, and moved back.
- ``recovery`` starts the second estimator and decides on its adoption.

The rules are on the page explanation/when_inputs_fail.md.
"""
