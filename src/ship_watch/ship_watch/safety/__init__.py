"""Safety of the angles and functions of a suite against the limits of the ship."""
