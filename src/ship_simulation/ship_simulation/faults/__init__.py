"""What goes wrong between a device and the suite: silence, lateness, wrong values, told in the scenario."""
