"""Recovery by a second estimator, which runs while the first is in trouble after a fault and may replace the first.

- ``trouble`` detects that the status of an estimator is worse than its inputs allow, or that a source is excluded.
- ``memory`` keeps the last consistent states.
- ``displacement`` and ``displacements`` show whether a source, or all sources together, have moved and moved back.
- ``recoverable_core`` holds what an estimator needs to be replaced.
- ``recovery`` starts the second estimator and decides on its adoption.

The rules are on the page explanation/recovery.md.
"""
