"""The core of the node ``ship_attitude``: INS and stars in, the ship's attitude with its error budget out.

``core`` feeds ``filter`` in the shell of every estimator. ``model`` names the devices and the states, ``comparison``
predicts what a device measures and compares it with what it measured, ``linearised`` does so where the estimate will
be, ``output`` makes the attitude of a state, ``alignment`` is what outlasts the voyage. The room may import
measurements, sky, stars and guards, not the core of ``star_attitude``.
"""
