"""What sensors say, as plain structs in radians, metres and nanoseconds.

The room imports no other room of the package.
"""
