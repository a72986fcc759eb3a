"""Command lines: arguments in, text and exit codes out.

The room imports all other rooms except ``trials/``.
"""
