"""The true sky over the ship, and what cameras that give single stars see of it."""
