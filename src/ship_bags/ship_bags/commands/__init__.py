"""The executables of the package: arguments in, exit codes out. They may import every room; no room imports them."""
