"""Data of the plots and log of the events of a suite, for the last minutes."""
