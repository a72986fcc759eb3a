"""The layout study: where on the ship to bolt star sensors, by the error model of their installation.

The room knows the errors of a sensor and of its installation, how several sensors join, and how to show that as
figures, tables and a page. Of the other rooms it imports the catalogue of stars alone.
"""
