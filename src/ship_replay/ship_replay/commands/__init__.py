"""Command lines: arguments, printed text and exit codes.

The folder imports all other folders.
"""
