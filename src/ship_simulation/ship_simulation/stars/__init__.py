"""The true sky over the ship, and the measurements of sensors that observe it.

The folder imports ``ship/``, ``random_draws`` and ``scenario/``, and catalogue and camera of ``ship_stars``.
"""
