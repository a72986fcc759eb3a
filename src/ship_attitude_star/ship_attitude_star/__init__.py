"""Ship attitude from an INS and star sensors: installation error model, fusion, nodes.

``stars`` computes an attitude from the stars of one or several exposures; ``star_attitude`` is the core of the node
that publishes these attitudes. ``ship_attitude`` is the core of the node that fuses an INS with attitudes by stars or
with single stars. ``sky`` computes apparent directions of stars, ``guards`` checks the plausibility of inputs, and
``measurements`` holds the measurement structs. Messages and nodes are in ``ros``, the study of sensor mountings in
``layout``.
"""
