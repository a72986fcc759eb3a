"""What sensors say, as plain structs in radians, metres and nanoseconds."""
