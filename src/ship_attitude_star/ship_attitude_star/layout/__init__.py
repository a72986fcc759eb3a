"""The layout study: where on the ship to bolt star sensors, by the error model of their installation.

The room knows the errors of a sensor and of its installation, how several sensors join, what is required of them, and
how to show that as figures, tables and a page. Of the other rooms it imports the catalogue of stars and the parameters
of masks alone.
"""
