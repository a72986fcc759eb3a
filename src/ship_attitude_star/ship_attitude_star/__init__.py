"""Ship attitude from an INS and star sensors: installation error model, fusion, node."""
