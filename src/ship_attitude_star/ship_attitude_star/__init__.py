"""Ship attitude from an INS and star sensors: installation error model, fusion, nodes.

``stars`` computes the attitude of one exposure, or of several joined ones, from its stars alone; ``star_attitude`` is
the core of the node that does so. ``ship_attitude`` is the core of the node that fuses an INS with such attitudes or
with single stars. ``sky`` computes apparent directions of stars, ``guards`` checks the plausibility of inputs, and
``measurements`` holds the measurement structs. Messages and nodes are in ``ros``, the study of sensor mountings in
``layout``.
"""
