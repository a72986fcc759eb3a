"""Time order: measurements and outputs in the order of their stamps, late and repeated data."""
