"""Earth: time scales, orientation, positions on the ellipsoid, directions of catalogue stars."""
