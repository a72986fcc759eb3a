"""Data of the plots of a suite, for the last minutes, and their recorder."""
