"""Layout study: error model of star sensor installations, to decide where on the ship to mount the sensors.

The folder contains the errors of sensors and installations, their combination, the requirement, and the output as
figures, tables and a page. Of ``ship_stars`` it imports only the star catalogue and the deck masks.
"""
