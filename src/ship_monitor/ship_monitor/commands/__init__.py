"""Executables: each module parses the arguments of one executable and connects the parts of the program."""
