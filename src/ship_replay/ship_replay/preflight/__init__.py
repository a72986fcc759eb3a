"""Checks of a suite configuration before the voyage, by itself and against a bag.

Of this package the folder imports only ``offline/``.
"""
