"""The executables: each module parses the arguments of one and imports the folders that it needs."""
