"""Recovery after a fault: a second estimator runs with the first one in trouble, and replaces it if it is confirmed.

- ``trouble`` detects that the status of an estimator is worse than its inputs allow.
- ``memory`` keeps the last consistent state.
- ``displacement`` and ``displacements`` measure whether a source, or all together, have moved, and moved back.
- ``recovery`` starts the second estimator and decides on its adoption.

The rules are on the page explanation/recovery.md.
"""
