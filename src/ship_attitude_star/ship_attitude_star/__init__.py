"""Ship attitude from an INS and star sensors: the cores and the nodes.

- ``nodes`` starts the nodes; ``adapters`` define which topic feeds which method of a core.
- ``messages`` has the inputs from the sensors, and converts messages to samples and results to messages.
- ``smoothing`` improves attitudes by later measurements.
- ``star_attitude`` is the core of the node that publishes attitudes by stars; ``ship_attitude`` is the core of the node
  that fuses an INS with attitudes by stars or with single stars.
- ``ins_errors`` are the error processes of an INS.
- ``vertical`` has the deflection of the vertical along the track.

Each room imports only rooms named below it. Sky, camera and attitude from stars are in :mod:`ship_stars`, the
plausibility checks of the inputs in :mod:`ship_estimation.plausibility`.
"""
