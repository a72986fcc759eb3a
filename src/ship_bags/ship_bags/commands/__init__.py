"""Executables of the package: arguments and exit codes. The folder may import all others; no folder imports it."""
