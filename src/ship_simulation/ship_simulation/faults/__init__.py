"""What goes wrong between a device and the suite: silence, lateness, wrong values, as a scenario or a file tells it.

The room spoils messages that others made, as they are simulated or from a bag. It imports ``scenario/``, the random
streams of ``draws/``, cameras and the star catalogue.
"""
