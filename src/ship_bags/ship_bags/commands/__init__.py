"""Executables of the package: arguments and exit codes. They may import every folder; no folder imports them."""
