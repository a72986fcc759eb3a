"""Recovery by a second estimator, which runs while the first is in trouble after a fault and may replace the first.

- ``displacement`` shows whether a source, or all sources together, have moved and moved back.
- ``recoverable_core`` holds what an estimator needs to be replaced.
- ``recovery`` detects trouble, keeps the last consistent states, starts the second estimator and decides on its
  adoption.

The rules are on the page explanation/recovery.md.
"""
