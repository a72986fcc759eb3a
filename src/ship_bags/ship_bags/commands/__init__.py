"""Executables of the package: arguments and exit codes. It may import all other folders; no folder imports it."""
