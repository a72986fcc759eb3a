"""What goes wrong between a device and the suite: silence, lateness, wrong values, told in the scenario.

The room spoils messages that others made. It imports ``scenario/`` alone.
"""
