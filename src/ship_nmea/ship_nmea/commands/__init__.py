"""The executables: each module parses the arguments of one executable and imports the folders that it needs."""
