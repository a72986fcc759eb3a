"""Theodolite pointing: axis errors calibrated by lights on drones, and the main axis in the horizon at each reading.

Rooms, each of which imports only those after it: ``axis_fit`` fits axis errors to a table of sightings; ``ros`` turns
messages into samples and results into messages; ``smoothing`` tells pointings once more with hindsight;
``optical_axis`` is the core of the node; ``target`` makes directions and places of targets; ``filter`` estimates;
``measured`` keeps what was measured; ``config`` holds the parameters; ``lights`` and ``chain`` are pure geometry.
"""
