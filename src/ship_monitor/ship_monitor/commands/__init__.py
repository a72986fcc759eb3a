"""Executables: each module parses the arguments of one of them and connects the parts that it needs."""
