"""Executables of the package: arguments and exit codes. They may import every room; no room imports them."""
