"""The executables of this package: command lines that may import everything."""
