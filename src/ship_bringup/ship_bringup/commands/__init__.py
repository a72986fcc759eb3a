"""Executables of this package: command lines that may import all folders."""
