"""The executables: each module parses the arguments of one and imports the rooms that it needs."""
