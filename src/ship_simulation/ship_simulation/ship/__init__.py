"""The ship's true motion and track, and the devices on board that measure attitude or position.

The folder imports ``random_draws`` and ``scenario/``, and neither ``stars/`` nor ``theodolite/``.
"""
