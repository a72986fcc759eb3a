"""Ship attitude from an INS and star sensors: installation error model, fusion, nodes.

Two ways lead from stars to an attitude. ``stars`` solves the attitude of one exposure, or of several joined, from its
stars alone; ``star_attitude`` is the core of the node that does so. ``ship_attitude`` is the core of the node that
fuses an INS with such attitudes, or with single stars. Where stars are seen is told by ``sky``, which inputs can be
true by ``guards``, what sensors say by ``measurements``; messages and nodes are in ``ros``, the study of where to bolt
sensors in ``layout``.
"""
